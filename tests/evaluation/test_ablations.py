"""What an observation's row sees, that a row learns from it, and the ablations' command."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal

from data.contact.features import FEATURES, SLOTS
from data.synthetic.contacts import SimulatedContact, draw_contacts
from data.synthetic.settings import SceneSettings
from estimators.network.draws import draw_observed
from estimators.network.fits import BOUNDS, MECHANICS, SCENES
from evaluation import ablations
from evaluation.ablations import Material, around_truth, judge, label_loss, seen_slots, train_row
from evaluation.recovery.evaluate import Recovery
from evaluation.recovery.scores import score_all, table_rows
from models.posterior import ContactPosterior
from physics.mechanics import theta_of
from physics.msd.simulation import simulate
from tests.evaluation.recovery_cases import BY_CONTACT

LOADED = (np.arange(SLOTS) < np.array([[7], [0], [SLOTS]])).astype(float)


@pytest.fixture(scope="module")
def contacts() -> list[SimulatedContact]:
    settings = SceneSettings(width=214, height=120, regime="critical")
    return [contact for seed in (1, 2) for contact in draw_contacts(settings, seed, 4, MECHANICS.time_step)]


@pytest.mark.parametrize("frames", [1, 2, 4, 8, 16, 25])
def test_a_number_sees_the_first_frames(frames: int) -> None:
    known = seen_slots(f"K={frames}", LOADED)
    assert known.shape == LOADED.shape
    assert known.sum(axis=1).tolist() == [frames] * 3
    assert known[:, :frames].all()


def test_release_sees_the_last_frame_under_load_and_final_the_last_of_all() -> None:
    release, final = seen_slots("release", LOADED), seen_slots("final", LOADED)
    assert release.argmax(axis=1).tolist() == [6, 0, SLOTS - 1]
    assert final.argmax(axis=1).tolist() == [SLOTS - 1] * 3
    assert release.sum(axis=1).tolist() == final.sum(axis=1).tolist() == [1.0] * 3


def test_the_supervised_row_sees_all_frames() -> None:
    np.testing.assert_array_equal(seen_slots("supervised", LOADED), np.ones_like(LOADED))


def test_the_supervised_loss_is_the_normal_density_of_the_truth(contacts: list[SimulatedContact]) -> None:
    torch.manual_seed(0)
    drawn = draw_observed(around_truth(contacts), 16, np.random.default_rng(0))
    posterior = ContactPosterior(FEATURES, torch.tensor(BOUNDS.log_box), width=16, blocks=1)
    mean, factor = (values.detach().double().numpy() for values in posterior(torch.from_numpy(drawn.features)))
    densities = [
        multivariate_normal.logpdf(logs, at, lower @ lower.T)
        for logs, at, lower in zip(drawn.logs, mean, factor, strict=True)
    ]
    expected = -np.mean(densities) - 1.5 * np.log(2 * np.pi)
    assert float(label_loss(posterior, drawn).detach()) == pytest.approx(expected, abs=1e-5)


def table(rows: list[Recovery]) -> dict:
    (scores,) = score_all(rows, BY_CONTACT)
    return {(row["regime"], row["parameter"]): row for row in table_rows(scores)}


def trained(row: str, material: Material, steps: int) -> list[Recovery]:
    return judge(train_row(row, material, steps, 0), row, material.held_out, 0)


@pytest.mark.slow
def test_the_supervised_row_alone_is_told_the_truth(contacts: list[SimulatedContact]) -> None:
    """Labels of other tissue, k_s half as stiff again, move what it answers, and no other row's numbers."""
    right = around_truth(contacts)
    wrong = dataclasses.replace(right, logs=right.logs + np.log([1.5, 1.0, 1.0]))
    (taught, misled), (blind, same) = (
        [table(trained(row, Material(right, labels, right), 80)) for labels in (right, wrong)]
        for row in ("supervised", "K=25")
    )
    key = "every clip", "stiffness"
    assert blind[key] == same[key]
    assert taught[key]["ratio"] < misled[key]["ratio"]
    assert taught[key]["constant_rmse_log"] == blind[key]["constant_rmse_log"]


def test_slopes_around_the_truth_are_the_simulator_s(contacts: list[SimulatedContact]) -> None:
    """Against central differences in log θ, in float64."""
    held, contact, step = around_truth(contacts[:1]), contacts[0].interaction, 1e-4

    def pressed(logs: np.ndarray) -> np.ndarray:
        path = simulate(theta_of(logs), contact.mesh, contact.load, MECHANICS, dtype=np.float64)
        return -(path[contact.observation.steps(MECHANICS.time_step)] @ contact.direction)

    for column, offset in enumerate(step * np.eye(3)):
        slope = (pressed(held.logs[0] + offset) - pressed(held.logs[0] - offset)) / (2 * step)
        np.testing.assert_allclose(held.slopes[0, :, column], slope, atol=1e-5)
    np.testing.assert_allclose(pressed(held.logs[0]), held.motion[0], atol=2e-4)
    assert held.loaded.sum() == round(contact.load_seconds * SCENES.fps)


def test_features_and_likelihood_know_the_seen_slots_alone(contacts: list[SimulatedContact]) -> None:
    fits = around_truth(contacts)
    drawn = draw_observed(fits, 64, np.random.default_rng(0), lambda loaded: seen_slots("K=4", loaded))
    assert not drawn.features[:, 4:SLOTS].any()
    assert drawn.features[:, 2 * SLOTS : 3 * SLOTS].sum(axis=1).tolist() == [4.0] * 64
    one = draw_observed(fits, 64, np.random.default_rng(0), lambda loaded: seen_slots("final", loaded))
    values = np.linalg.eigvalsh(one.information)
    assert (values[:, 1] < 1e-9 * values[:, 2]).all()  # one number tells one direction


def test_estimates_are_judged_beside_the_truth(contacts: list[SimulatedContact]) -> None:
    held = around_truth(contacts[:3])
    torch.manual_seed(0)
    posterior = ContactPosterior(FEATURES, torch.tensor(BOUNDS.log_box), width=16, blocks=1).eval()
    rows = judge(posterior, "K=4", held, 0)
    assert [(row.estimator, row.suite, row.index) for row in rows] == [("K=4", "held-out", index) for index in range(3)]
    assert {row.regime for row in rows} == {"critical"}
    np.testing.assert_allclose([row.theta for row in rows], [contact.theta for contact in contacts[:3]])
    information = np.array([row.information for row in rows])
    np.testing.assert_allclose(information[:, :3, :3], np.einsum("ntp,ntq->npq", held.slopes, held.slopes))
    # Its presses begin and end at their stamps: delays are known and have no part in it.
    assert information.shape == (3, 5, 5)
    assert not information[:, 3:].any()
    assert not information[:, :, 3:].any()
    again = judge(posterior, "final", held, 0)
    np.testing.assert_array_equal([row.tracking for row in rows], [row.tracking for row in again])


def test_seeing_more_frames_leaves_a_smaller_error(
    contacts: list[SimulatedContact], monkeypatch: pytest.MonkeyPatch
) -> None:
    """On eight contacts, a row learns what its frames tell."""
    monkeypatch.setattr(ablations, "FINE_BATCH", 64)
    monkeypatch.setattr(ablations, "EXAMPLES", 500)
    material = Material(*[around_truth(contacts)] * 3)
    many, few = (table(trained(row, material, 40))["all", "force/damping"] for row in ("K=25", "K=1"))
    assert many["rmse_log"] < few["rmse_log"]
    assert many["bound_log"] == few["bound_log"]


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    torch.save(ContactPosterior(FEATURES, torch.from_numpy(BOUNDS.log_box)).state_dict(), tmp_path / "posterior.pt")
    return tmp_path / "posterior.pt"


def test_finished_rows_are_not_measured_again(
    tmp_path: Path,
    weights: Path,
    contacts: list[SimulatedContact],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture,
) -> None:
    held, measured = around_truth(contacts[:2]), []

    def train(row: str, *_: object) -> ContactPosterior:
        measured.append(row)
        if row == "K=2" and len(measured) == 2:
            raise KeyboardInterrupt
        return ContactPosterior(FEATURES, torch.tensor(BOUNDS.log_box), width=16, blocks=1).eval()

    monkeypatch.setattr(ablations, "make_material", lambda *_: Material(held, held, held))
    monkeypatch.setattr(ablations, "train_row", train)
    monkeypatch.setattr("evaluation.recovery.figures.figures", lambda scores: [])
    command = ["--output", str(tmp_path / "out"), "--weights", str(weights), "--rows", "K=2", "K=1"]
    assert ablations.main(command) == ablations.INTERRUPTED
    assert "finished rows are kept" in capsys.readouterr().err
    assert ablations.main([*command, "K=4"]) == 0
    assert measured == ["K=1", "K=2", "K=2", "K=4"]
    text = (tmp_path / "out" / "table.csv").read_text()
    assert list(dict.fromkeys(line.split(",")[0] for line in text.splitlines())) == ["estimator", "K=1", "K=2", "K=4"]
    assert ablations.main([*command, "--steps", "7"]) == 2
    assert "holds results of another steps" in capsys.readouterr().err


def test_impossible_options_are_told(tmp_path: Path, weights: Path, capsys: pytest.CaptureFixture) -> None:
    command = ["--output", str(tmp_path / "out"), "--weights"]
    for options in ([str(tmp_path / "none.pt")], [str(weights), "--contacts", "0"]):
        with pytest.raises(SystemExit) as stop:
            ablations.main([*command, *options])
        assert stop.value.code == 2
    assert "--contacts: 0 is less than 1" in capsys.readouterr().err


@pytest.mark.slow
def test_a_whole_run_at_toy_size(tmp_path: Path, weights: Path) -> None:
    sizes = {"contacts": 16, "held-out": 16, "steps": 5, "workers": 0}
    options = [part for name, value in sizes.items() for part in (f"--{name}", str(value))]
    folder = tmp_path / "out"
    assert ablations.main(["--output", str(folder), "--weights", str(weights), "--rows", "K=4", *options]) == 0
    assert "K=4,held-out,all,force/damping,16" in (folder / "table.csv").read_text()
    assert (folder / "figures" / "recovery_K=4_held-out.png").is_file()
