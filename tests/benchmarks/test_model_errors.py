"""What fits get wrong: the file holds what the command measured last, and the command measures what is there."""

import math
from pathlib import Path

import numpy as np
import pytest

from benchmarks import model_errors
from benchmarks import model_errors as module
from benchmarks.harness import Row
from benchmarks.recovery.trial import Trial
from palpate.estimators.grip.grip_estimate import force_error
from palpate.estimators.model_errors import FILE, MODEL_ERRORS, read_entries
from palpate.models.calibration_fit import mean_squares

VALUES = vars(MODEL_ERRORS)


def test_the_file_is_as_the_command_wrote_it_last(tmp_path: Path) -> None:
    entries = read_entries()
    model_errors.write_entries(tmp_path / "same.yaml", entries)
    assert (tmp_path / "same.yaml").read_text(encoding="utf-8") == FILE.read_text(encoding="utf-8")
    for name, entry in entries.items():
        assert VALUES[name] == entry["value"]
        assert entry["meaning"]
        assert entry["source"]
        if entry["measured"] is not None:
            measured = entry["measured"]
            if name.endswith("_slope"):
                value = measured["slope"]
            else:
                value = measured["sd"]
                assert value == model_errors.model_sd(measured["off"], measured["stated"])
            assert measured["command"].startswith("python -m benchmarks.model_errors --part ")
            assert entry["value"] == value or measured["clips"] < model_errors.ENOUGH


def test_a_file_with_other_entries_is_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "other.yaml").write_text("contact_rest: {value: 1.0}\n")
    with pytest.raises(ValueError, match=r"other\.yaml holds other entries than pull_force, "):
        read_entries(tmp_path / "other.yaml")


def drawn(index: int, model: float, told: float = 0.004) -> Row:
    """A pull whose relative force has errors that residuals tell, and errors of the model."""
    true, skill = np.linspace(0.1, 1.0, 10), 0.6
    shape, rng = force_error(true, skill), np.random.default_rng(index)
    force = true + shape * rng.normal(0, math.hypot(model, told / 0.1), 10)
    sd = force_error(force, skill) * math.hypot(VALUES["pull_force"], told / 0.1)
    return {"skill": skill, "curve": np.array([true, force, sd])}


def test_what_the_model_gets_wrong_is_found() -> None:
    rows = [drawn(index, 0.3) for index in range(400)]
    entries = model_errors.updated(read_entries(), model_errors.pull_errors(rows, VALUES), "a command", "today")
    found = entries["pull_force"]
    assert found["value"] == found["measured"]["sd"] == pytest.approx(0.3, rel=0.1)
    assert found["measured"]["stated"] == pytest.approx(0.04, rel=0.1)
    assert found["source"] == "measured"
    # Few clips are noted, and change nothing.
    few = model_errors.pull_errors(rows[: model_errors.ENOUGH - 1], VALUES)
    entry = model_errors.updated(read_entries(), few, "a command", "today")["pull_force"]
    assert entry["value"] == VALUES["pull_force"]
    assert entry["measured"]["clips"] == model_errors.ENOUGH - 1
    # A pull that is not explained doesn't count.
    assert model_errors.pull_errors([rows[0] | {"skill": 0.2}], VALUES) == {}


def test_videos_tell_three_quantities_whatever_a_fit_makes_of_each_clip() -> None:
    generator = np.random.default_rng(3)
    quantities = {"damping_over_stiffness": "damping", "force_over_stiffness": "force", "stiffness": "scale"}
    rows: list[Row] = [{"verdict": "no_estimate"}, {"verdict": "undetermined", "explained": 0}]
    for factor in generator.uniform(1, 4, 400):
        row: Row = {"explained": 1}
        for name, kind in quantities.items():
            counted = factor * VALUES[f"shading_{kind}"]
            row |= {f"{name}_error": factor * generator.normal(0, math.hypot(0.25, 0.1))}
            row |= {f"{name}_model_sd": counted, f"{name}_sd": math.hypot(counted, factor * 0.1)}
        rows.append(row)
    entries = model_errors.updated(read_entries(), model_errors.video_errors(rows, VALUES), "a command", "today")
    for kind in quantities.values():
        assert entries[f"shading_{kind}"]["value"] == pytest.approx(0.25, rel=0.1)
        assert entries[f"shading_{kind}"]["measured"]["stated"] == pytest.approx(0.1, rel=0.01)


def test_clips_count_by_how_little_their_residuals_leave_open() -> None:
    """The most likely variance of a normal distribution, also where a few clips tell next to nothing."""
    generator = np.random.default_rng(5)
    variances = np.where(np.arange(600) % 3 == 0, 4.0, 0.01)
    errors = generator.normal(0, np.sqrt(variances + 0.2**2))
    off, stated = mean_squares(errors, variances)
    assert math.sqrt(off - stated) == pytest.approx(0.2, rel=0.1)
    candidates = np.linspace(0.05, 0.5, 1000)
    total = variances + np.square(candidates)[:, None]
    likely = candidates[np.argmin((np.log(total) + np.square(errors) / total).sum(axis=1))]
    assert math.sqrt(off - stated) == pytest.approx(likely, abs=1e-3)


def test_the_command_writes_what_it_measures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def evaluated(trial: Trial) -> list[Row]:
        return [drawn(trial.index, 0.1) for suite in trial.wanted if suite == "foundation"]

    monkeypatch.setattr(module, "run_trial", evaluated)
    output = tmp_path / "errors.yaml"
    assert model_errors.main(["--part", "pull", "--clips", "3", "--seed", "5", "--output", str(output)]) == 0
    measured = read_entries(output)["pull_force"]["measured"]
    assert measured["clips"] == 3
    assert measured["command"] == "python -m benchmarks.model_errors --part pull --clips 3 --seed 5"
    monkeypatch.setattr(module, "run_trial", lambda _: [])
    assert model_errors.main(["--part", "pull", "--clips", "1", "--seed", "5", "--output", str(output)]) == 1
