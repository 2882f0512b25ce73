"""Training the contact posterior: fits, drawn errors, and that the fine stage learns what a fit would say."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from rich.progress import Progress

from data.contact.features import SLOTS
from data.synthetic.contacts import SimulatedContact, draw_contacts
from data.synthetic.settings import SceneSettings
from data.synthetic.truth import damping_ratio, regime_of
from estimators.network import training as contact_training
from estimators.network.fits import (
    BOUNDS,
    LEVEL,
    MECHANICS,
    NOISE,
    REST_SHARE,
    SCENES,
    Fits,
    draw_errors,
    draw_known,
    draw_observed,
    fit_motion,
)
from estimators.network.training import (
    INTERRUPTED,
    Trainer,
    TrainingError,
    descend,
    expected_loss,
    fine_loss,
    main,
    make_contacts,
    widened,
)
from estimators.worker_pool import WorkerLost
from physics.identifiability import LIMIT, bounds


@pytest.fixture(scope="module")
def contacts() -> list[SimulatedContact]:
    """A few contacts of two scenes."""
    settings = SceneSettings(width=214, height=120, regime="critical")
    return [contact for seed in (1, 2) for contact in draw_contacts(settings, seed, 4, MECHANICS.time_step)]


def test_a_fit_explains_its_motion(contacts: list[SimulatedContact]) -> None:
    """From a poor start: θ within the integrators' difference, and slopes that predict the effect of another θ."""
    contact = contacts[0]
    logs, slopes, rms = fit_motion((contact.interaction, BOUNDS.log_box.mean(axis=0)))
    assert rms < 1e-4
    np.testing.assert_allclose(logs, np.log(np.abs(contact.theta)), atol=0.05)
    assert slopes.shape == (SLOTS, 3)
    assert (slopes[:, 2] > 0).all()  # more force, more motion


def test_drawn_errors_are_as_large_as_said() -> None:
    generator = np.random.default_rng(0)
    motion = np.linspace(0, 0.05, SLOTS)[None].repeat(4000, axis=0)
    error, noise = draw_errors(motion, generator)
    assert (noise.min(), noise.max()) == (pytest.approx(NOISE[0], rel=0.1), pytest.approx(NOISE[1], rel=0.1))
    rounded = noise == LEVEL / np.sqrt(12)
    assert 0.2 < rounded.mean() < 0.3
    scaled = error / noise[:, None]
    for kind in (rounded, ~rounded):
        assert np.sqrt(np.square(scaled[kind]).mean()) == pytest.approx(np.sqrt(1 + REST_SHARE**2), rel=0.02)
    # What a clip's frames share is the error of the rest position, and rounding stays within half a step of it.
    assert scaled[~rounded].mean(axis=1).std() == pytest.approx(np.hypot(REST_SHARE, 1 / np.sqrt(SLOTS)), rel=0.05)
    assert np.abs(error[rounded]).max() < LEVEL / 2 + 5 * REST_SHARE * LEVEL / np.sqrt(12)


def test_windows_are_cut_at_their_end() -> None:
    known = draw_known(2000, np.random.default_rng(0))
    lengths = known.sum(axis=1)
    assert lengths.min() == 2
    assert 0.65 < (lengths == SLOTS).mean() < 0.75
    assert (np.diff(known, axis=1) <= 0).all()


def test_a_wider_noise_level_tells_less(contacts: list[SimulatedContact]) -> None:
    logs = np.log(np.abs(contacts[0].theta))
    contact = contacts[0].interaction
    narrow, wide = (widened(contact, logs, blur) for blur in (0.1, 0.2))
    np.testing.assert_allclose(narrow.information, 4 * wide.information, rtol=1e-6)


def fitted(contacts: list[SimulatedContact]) -> Fits:
    """Around what explains each, found from the truth."""
    found = [fit_motion((contact.interaction, np.log(np.abs(contact.theta)))) for contact in contacts]
    logs, slopes, _ = zip(*found, strict=True)
    return Fits.of([contact.interaction for contact in contacts], logs, slopes)


def descended(network: torch.nn.Module, loss: Callable[[], torch.Tensor], steps: int) -> None:
    assert len(list(descend(network, lambda _: loss(), steps, 2e-3))) == steps


@pytest.mark.slow
def test_the_fine_stage_learns(contacts: list[SimulatedContact]) -> None:
    """On eight contacts, a hundred steps bring the estimates nearer to what explains the motions."""
    posterior, fits = Trainer(contacts, 0).posterior, fitted(contacts)
    generator = np.random.default_rng(1)
    held_out = draw_observed(fits, 400, np.random.default_rng(5))

    def error() -> float:
        with torch.no_grad():
            mean = posterior(torch.from_numpy(held_out.features))[0].double().numpy()
        return float(np.sqrt(np.square(mean - held_out.logs).mean()))

    before = error()
    descended(posterior, lambda: fine_loss(posterior, draw_observed(fits, 64, generator)), 100)
    assert error() < 0.5 * before


@pytest.mark.slow
def test_the_expected_bound_learns_and_leaves_the_posterior_alone(contacts: list[SimulatedContact]) -> None:
    """On eight contacts, two hundred steps tell how well each was seen, under noise that was not drawn before."""
    posterior, fits = Trainer(contacts, 0).posterior, fitted(contacts)
    generator = np.random.default_rng(1)
    drawn = draw_observed(fits, 400, np.random.default_rng(5))
    features, true = torch.from_numpy(drawn.features), bounds(drawn.information)

    def told() -> tuple[torch.Tensor, torch.Tensor, np.ndarray]:
        with torch.no_grad():
            bound = posterior.expected_bound_factor(features).double().numpy()
            return *posterior(features), np.linalg.norm(bound, axis=2)

    mean, factor, before = told()
    descended(posterior.expected_bound, lambda: expected_loss(posterior, draw_observed(fits, 128, generator)), 200)
    same_mean, same_factor, expected = told()
    off = [np.median(np.abs(np.log(each / true))[true < LIMIT]) for each in (before, expected)]
    assert off[1] < 0.5 * off[0]
    assert torch.equal(mean, same_mean)
    assert torch.equal(factor, same_factor)
    clear = np.abs(np.log(true / LIMIT)) > np.log(1.5)
    assert ((expected < LIMIT) == (true < LIMIT))[clear].mean() > 0.93
    assert 0.2 < (true < LIMIT)[clear].mean() < 0.85  # a guess would be wrong more often


def test_contacts_are_of_every_regime() -> None:
    """In turn by scene, as in the benchmark."""
    drawn = make_contacts(24, 3, Progress(disable=True), 0)
    regimes = [regime_of(damping_ratio(*contact.theta[:2], SCENES.mass)) for contact in drawn]
    assert regimes == ["under-damped"] * 8 + ["critical"] * 8 + ["over-damped"] * 8


@pytest.mark.slow
def test_contacts_and_fits_are_the_same_in_processes_of_their_own(contacts: list[SimulatedContact]) -> None:
    """Equal to the last bit, and in order: a training does not depend on how many cores there are."""
    here, there = (make_contacts(12, 3, Progress(disable=True), workers) for workers in (0, 2))
    assert len(here) == len(there) == 16  # two scenes
    for one, other in zip(here, there, strict=True):
        assert np.array_equal(one.theta, other.theta)
        assert np.array_equal(one.interaction.moved, other.interaction.moved)
        assert np.array_equal(one.interaction.mesh.vertices, other.interaction.mesh.vertices)
    fits, same = (Trainer(contacts, 0).fit(Progress(disable=True), workers) for workers in (0, 2))
    assert len(fits.logs) > 0
    for field in dataclasses.fields(Fits):
        assert np.array_equal(getattr(fits, field.name), getattr(same, field.name))


@pytest.mark.parametrize(
    ("option", "value", "reason"),
    [
        ("--contacts", "0", "0 is less than 1"),
        ("--contacts", "many", "is not a whole number"),
        ("--rough-steps", "3", "3 is less than 4"),
        ("--fine-steps", "0", "0 is less than 4"),
        ("--fine-steps", "3", "3 is less than 4"),
        ("--bound-steps", "3", "3 is less than 4"),
        ("--seed", "-1", "-1 is less than 0"),
        ("--seed", str(2**63), "is more than"),
        ("--workers", "-1", "-1 is less than 0"),
    ],
)
def test_numbers_that_would_end_a_training_late_are_refused_at_once(
    option: str, value: str, reason: str, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--output", str(tmp_path / "out"), option, value])
    assert ended.value.code == 2
    assert reason in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out").exists()


@pytest.fixture
def few(contacts: list[SimulatedContact], monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawing takes no time, and steps hardly any."""
    monkeypatch.setattr(contact_training, "make_contacts", lambda *_: contacts[:2])
    monkeypatch.setattr(contact_training, "ROUGH_BATCH", 8)
    monkeypatch.setattr(contact_training, "FINE_BATCH", 32)


def short(folder: Path) -> int:
    steps = [text for stage in ("rough", "fine", "bound") for text in (f"--{stage}-steps", "4")]
    return main(["--output", str(folder), *steps, "--workers", "0"])


def test_a_training_leaves_its_weights_and_its_record(few, tmp_path: Path) -> None:
    assert short(tmp_path / "out") == 0
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["posterior.pt", "training.jsonl"]
    rows = [json.loads(line) for line in (tmp_path / "out" / "training.jsonl").read_text().splitlines()]
    assert [(row["stage"], row["step"]) for row in rows] == [
        (s, n) for s in ("rough", "fine", "bound") for n in (1, 2, 3, 4)
    ]
    weights = torch.load(tmp_path / "out" / "posterior.pt", weights_only=True)
    assert all(torch.isfinite(value).all() for value in weights.values())


def test_a_finished_training_is_not_written_over(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    for name in ("posterior.pt", "training.jsonl"):
        (tmp_path / name).write_text(name)
    assert short(tmp_path) == 2
    assert "holds a finished training" in capsys.readouterr().err
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {
        name: name for name in ("posterior.pt", "training.jsonl")
    }


@pytest.mark.parametrize(
    ("error", "status", "told"),
    [
        (KeyboardInterrupt(), INTERRUPTED, "Interrupted;"),
        (WorkerLost("A worker was killed."), 1, "A worker was killed."),
        (OSError("The disk is full."), 1, "The disk is full."),
    ],
)
def test_what_ends_a_training_is_one_sentence(
    error: BaseException,
    status: int,
    told: str,
    few,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture,
) -> None:
    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(contact_training, "fine_loss", fail)
    assert short(tmp_path) == status
    caught = capsys.readouterr().err
    assert caught.startswith(told)
    assert "Traceback" not in caught
    assert not (tmp_path / "posterior.pt").exists()
    assert len((tmp_path / "training.jsonl").read_text().splitlines()) == 4  # of the stage before


def test_nothing_to_train_on_is_told(contacts: list[SimulatedContact], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contact_training, "EXPLAINED", -1.0)
    with pytest.raises(TrainingError, match="No motion could be explained"):
        Trainer(contacts[:2], 0).fit(Progress(disable=True), 0)
    monkeypatch.setattr(contact_training, "draw_contacts", lambda *_: [])
    with pytest.raises(TrainingError, match="No contact could be drawn"):
        make_contacts(8, 0, Progress(disable=True), 0)
