"""The ablations' command: columns, what is kept, what fails, and a whole run at toy size."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from data.contact.features import FEATURES
from estimators.network.fits import BOUNDS
from evaluation.ablations import __main__ as ablations
from evaluation.ablations import observation as ablation_observation
from evaluation.ablations import training as ablation_training
from evaluation.ablations.output import COLUMNS, FAILED, Result, draw, keep, kept, write_all
from evaluation.ablations.rows import ROWS
from evaluation.ablations.scores import NUMBERS, numbers
from evaluation.ablations.training import RowFailed, TrainingSettings, next_depth, require_steps, train_row
from models.posterior import ContactPosterior

SETTINGS = {"steps": 100}
VALUES = dict.fromkeys(NUMBERS, 1.0) | {"judged": 7, "over_bound_damping": 2.345, "coverage_force": None}


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    torch.save(ContactPosterior(FEATURES, torch.from_numpy(BOUNDS.log_box)).state_dict(), tmp_path / "posterior.pt")
    return tmp_path / "posterior.pt"


def test_the_rows_are_those_that_were_asked_for() -> None:
    assert list(ROWS)[:9] == ["K=1", "K=2", "K=4", "K=8", "K=16", "K=25", "release", "final", "supervised"]
    terms = {row.name: row.options[::2] for row in ROWS.values() if row.name.startswith("no-")}
    assert terms["no-gan-no-cycle"] == ("--model.weights.gan", "--model.weights.cycle")
    assert sorted(term for found in terms.values() for term in found if len(found) == 1) == [
        f"--model.weights.{term}" for term in ("cycle", "gan", "identity", "physics", "regularisation")
    ]
    assert ROWS["paper"].config == "configs/paper.yaml"
    assert {"baseline", "scratch", "posterior"} < set(ROWS)


def test_numbers_are_errors_over_bounds_of_the_identifiable_contacts() -> None:
    errors = np.array([[0.1, 0.2, 0.3, 0.4, 0.5], [0.1, -0.2, -0.3, -0.4, 0.5], [9.0, 0.2, 0.0, 0.0, 0.5]])
    bounds = np.full((3, 5), 0.1)
    bounds[2, 0] = 0.6  # its stiffness is not identifiable
    found = numbers(errors, 2 * errors, bounds, np.full((3, 5), 0.13))
    assert found["judged"] == 3
    assert found["over_bound_stiffness"] == pytest.approx(1.0)
    assert found["over_bound_damping"] == pytest.approx(2.0)
    assert found["constant_over_bound_damping"] == pytest.approx(4.0)
    assert found["rms_force_damping"] == pytest.approx(0.5)
    assert (found["coverage_stiffness"], found["coverage_damping"]) == (1.0, 1.0)
    assert found["coverage_force"] == pytest.approx(1 / 3)
    none = numbers(errors, errors, bounds, np.full((3, 5), np.nan))
    assert none["coverage_force"] is None
    assert set(found) | {"next_depth_over_copy"} == set(NUMBERS)


def test_table_has_a_line_a_row_in_order_and_says_what_failed(tmp_path: Path) -> None:
    results = [
        Result("no-gan", SETTINGS, FAILED, "fit ended | with status 1", 3.0),
        Result("posterior", SETTINGS, seconds=2.4, numbers=VALUES),
        Result("K=4", SETTINGS, seconds=12.0, numbers=VALUES),
    ]
    write_all(results, tmp_path)
    with (tmp_path / "ablations.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert list(lines[0]) == list(COLUMNS)
    assert [line["row"] for line in lines] == ["K=4", "posterior", "no-gan"]
    assert [line["steps"] for line in lines] == ["100", "0", "100"]
    assert (lines[0]["over_bound_damping"], lines[0]["coverage_force"]) == ("2.345", "")
    assert (lines[2]["status"], lines[2]["judged"]) == ("failed", "")
    text = (tmp_path / "ablations.md").read_text()
    assert "| K=4 | the first 4 frames after the onset | 100 | 1.00, 2.35, 1.00 |" in text
    assert "failed: fit ended / with status 1" in text
    widths = {line.count("|") for line in text.split("\n\n")[3].splitlines()}
    assert len(widths) == 1
    assert (tmp_path / "ablations.png").stat().st_size > 10_000


def test_figure_has_labelled_axes_and_a_point_a_parameter() -> None:
    figure = draw([Result("K=4", SETTINGS, numbers=VALUES), Result("baseline", SETTINGS, numbers=VALUES)])
    assert len(figure.axes) == 2
    for axes, row in zip(figure.axes, ("K=4", "baseline"), strict=True):
        assert axes.get_ylabel() == "RMS error of log θ / Cramér–Rao bound [–]"
        assert axes.get_xlabel()
        assert [label.get_text() for label in axes.get_xticklabels()] == [row]
        points = {line.get_label(): line.get_ydata() for line in axes.lines}
        assert points["$k_d$"] == pytest.approx([2.345])


def test_a_finished_row_is_kept_unless_the_settings_changed(tmp_path: Path) -> None:
    result = Result("K=4", SETTINGS, seconds=1.0, numbers=VALUES)
    keep(result, tmp_path)
    assert kept("K=4", SETTINGS, tmp_path) == result
    assert kept("K=4", {"steps": 101}, tmp_path) is None
    (tmp_path / "K=8.json").write_text("{")
    assert kept("K=8", SETTINGS, tmp_path) is None
    assert [path.name for path in tmp_path.iterdir() if "unfinished" in path.name] == []


def test_finished_rows_are_not_measured_again_and_a_failed_one_is_reported(
    tmp_path: Path, weights: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    measured = []

    def train(row: str, *_):
        measured.append(row)
        if row == "2":
            raise ValueError("no such\nluck")
        return dict(VALUES)

    monkeypatch.setattr(ablation_observation, "write_material", lambda path, *_: path.touch())
    monkeypatch.setattr(ablation_observation, "read_material", lambda path: None)
    monkeypatch.setattr(ablation_observation, "train_row", train)
    command = ["--output", str(tmp_path / "out"), "--weights", str(weights), "--workers", "1", "--rows", "K=1", "K=2"]
    monkeypatch.setattr(ablations, "run_tasks", lambda function, tasks, workers: map(function, tasks))
    assert ablations.main(command) == 1
    assert "K=2 failed: ValueError: no such luck" in capsys.readouterr().err
    assert ablations.main([*command, "K=4"]) == 1
    assert measured == ["1", "2", "2", "4"]
    with (tmp_path / "out" / "ablations.csv").open() as file:
        assert [line["status"] for line in csv.DictReader(file)] == ["ok", "failed", "ok"]
    assert ablations.main([*command, "--observation-steps", "7"]) == 1
    assert measured[4:] == ["1", "2"]


def test_impossible_options_are_told(tmp_path: Path, weights: Path, capsys: pytest.CaptureFixture) -> None:
    command = ["--output", str(tmp_path / "out"), "--weights", str(weights)]
    assert ablations.main([*command, "--training-steps", "70"]) == 2
    assert "--training-steps is 70; give a multiple of 50" in capsys.readouterr().err
    assert ablations.main(["--output", str(tmp_path), "--weights", str(tmp_path / "none.pt")]) == 2
    with pytest.raises(SystemExit):
        ablations.main([*command, "--contacts", "0"])


def test_next_depth_is_the_decoder_s_error_over_that_of_copying(tmp_path: Path) -> None:
    content = {"depth": {"decoder": {"mean": {"value": 0.3}}, "copy": {"mean": {"value": 0.2}}}}
    (tmp_path / "evaluation.json").write_text(json.dumps(content))
    assert next_depth(tmp_path / "evaluation.json") == pytest.approx(1.5)


def test_a_training_that_ends_badly_says_how(tmp_path: Path, weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """There are no clips, so that train.py refuses."""
    settings = TrainingSettings(steps=50, width=4, residual_blocks=1, training_clips=16, clips=1, seed=0)
    with pytest.raises(RowFailed, match=r"train\.py fit ended with status 1: .*clips.*fit\.log\)"):
        train_row(ROWS["baseline"], tmp_path, weights, settings, np.zeros(3))


def test_a_row_is_trained_tested_exported_and_judged(
    tmp_path: Path, weights: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Equal compute, and nothing but the row's own change on its command lines."""
    commands, judged = {}, {}

    def run(arguments: tuple[str, ...], log: Path) -> None:
        commands.setdefault(log.parent.name, []).append(arguments)
        (log.parent / "parameters.onnx").write_bytes(b"network")
        (log.parent / "checkpoints").mkdir(exist_ok=True)
        done = {"fit_loop": {"epoch_loop.batch_progress": {"total": {"completed": 150}}}}
        torch.save({"loops": done}, log.parent / "checkpoints" / "last.ckpt")

    monkeypatch.setattr(ablation_training, "_run", run)
    monkeypatch.setattr(ablation_training, "next_depth", lambda path: 1.25)
    monkeypatch.setattr(
        ablation_training, "judge", lambda options, *_: judged.update({options.model: options.name}) or {}
    )
    settings = TrainingSettings(steps=150, width=4, residual_blocks=1, training_clips=16, clips=1, seed=0)
    names = ("baseline", "no-gan", "scratch", "paper")
    found = [train_row(ROWS[name], tmp_path, weights, settings, np.zeros(3)) for name in names]
    assert found == [{"next_depth_over_copy": 1.25}] * 4
    assert list(judged.values()) == ["network", "network", "network", "gan"]
    for name in names:
        assert [command[:2] for command in commands[name]] == [("train.py", c) for c in ("fit", "test", "export")]
        fit, test, export = (dict(zip(command[2::2], command[3::2], strict=True)) for command in commands[name])
        assert (fit["--trainer.max_epochs"], fit["--trainer.limit_train_batches"]) == ("3", "50")
        assert fit["-c"] == ("configs/paper.yaml" if name == "paper" else "configs/recommended.yaml")
        assert ("--model.pretrained" in fit) == (name in ("baseline", "no-gan"))
        assert fit.get("--model.weights.gan") == ("0" if name == "no-gan" else None)
        assert test["--ckpt_path"] == export["--ckpt_path"] == "last"


def test_a_training_of_fewer_steps_is_refused(tmp_path: Path) -> None:
    done = {"fit_loop": {"epoch_loop.batch_progress": {"total": {"completed": 45}}}}
    torch.save({"loops": done}, tmp_path / "last.ckpt")
    require_steps(tmp_path / "last.ckpt", 45)
    with pytest.raises(RowFailed, match="45 of 50 steps were made"):
        require_steps(tmp_path / "last.ckpt", 50)


@pytest.mark.slow
def test_a_whole_run_at_toy_size(tmp_path: Path, weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One row of each family, from contacts and clips to the table."""
    monkeypatch.setattr(ablation_training, "EPOCH", 2)
    monkeypatch.setattr(ablations, "EPOCH", 2)
    monkeypatch.setattr(ablations, "CONSTANT_CLIPS", 2)
    folder = tmp_path / "out"
    sizes = {"contacts": 16, "held-out": 16, "observation-steps": 5, "training-clips": 5, "training-steps": 2}
    sizes |= {"width": 2, "residual-blocks": 1, "validation-clips": 3, "workers": 0}
    options = [part for name, value in sizes.items() for part in (f"--{name}", str(value))]
    rows = ["--rows", "K=4", "baseline"]
    status = ablations.main(["--output", str(folder), "--weights", str(weights), *rows, *options])
    assert status == 0, (folder / "ablations.csv").read_text()
    with (folder / "ablations.csv").open() as file:
        lines = {line["row"]: line for line in csv.DictReader(file)}
    assert float(lines["K=4"]["over_bound_stiffness"]) > 1
    assert float(lines["K=4"]["next_depth_over_copy"] or 0) == 0
    assert int(lines["baseline"]["judged"]) > 0
    assert float(lines["baseline"]["next_depth_over_copy"]) > 1
    assert float(lines["baseline"]["coverage_stiffness"]) >= 0
