"""Training the contact posterior: fits, drawn errors, and that the fine stage learns what a fit would say."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from palpate.cli import train
from palpate.common.doors import INTERRUPTED
from palpate.common.output import LIST
from palpate.common.workers import WorkerLost
from palpate.data.contact.features import FEATURES, SLOTS, contact_surroundings
from palpate.data.contact.sequence_features import SEQUENCE_FEATURES
from palpate.data.synthetic.contacts import SimulatedContact, draw_contacts
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.truth import regime_of
from palpate.estimators.network import fits as drawing
from palpate.estimators.network import training as contact_training
from palpate.estimators.network.fits import FRAME_S, LEVEL, MECHANICS, Fits, Fitted, draw_observed, fit_sequence
from palpate.estimators.network.training import Made, SimulatedContacts, make_contacts
from palpate.models import contact_module
from palpate.models.posterior import ContactPosterior
from palpate.physics.identifiability import LIMIT, bounds
from palpate.physics.mechanics import RECOMMENDED, damping_ratio
from tests.tables import read_rows

CONFIG = Path(__file__).resolve().parents[3] / "configs" / "contact.yaml"
CRITICAL = SceneSettings(width=214, height=120, regime="critical")
MADE = [0.0, FRAME_S]
"""How well instants are known in both halves of a training's contacts."""


@pytest.fixture(scope="module")
def contacts() -> list[SimulatedContact]:
    """A few contacts of two scenes, whose instants are known to a frame only."""
    scenes = [draw_contacts(CRITICAL, seed, 2, MECHANICS.time_step, FRAME_S, sequence=True) for seed in (1, 2)]
    return [contact for contacts in scenes for contact in contacts]


@pytest.fixture(scope="module")
def unsure() -> list[SimulatedContact]:
    """Two contacts, of the second of which the instants are known to a frame only."""
    return [draw_contacts(CRITICAL, 3, 1, MECHANICS.time_step, within, sequence=True)[0] for within in MADE]


def test_a_fit_explains_its_motion(unsure: list[SimulatedContact], fitted: list[Fitted]) -> None:
    """From a poor start: θ within the integrators' difference, and slopes that predict the effect of another θ."""
    contact, fit = unsure[0], fitted[0]
    assert fit.rms < 1e-4
    np.testing.assert_allclose(fit.logs[:3], np.log(np.abs(contact.theta)), atol=0.05)
    assert fit.slopes.shape == (SLOTS, drawing.PARAMETERS)
    assert (fit.slopes[:, 2] > 0).all()  # more force, more motion


def test_drawn_errors_are_as_large_as_said() -> None:
    generator = np.random.default_rng(0)
    motion = np.linspace(0, 0.05, SLOTS)[None].repeat(4000, axis=0)
    error, noise = drawing.draw_errors(motion, generator)
    assert (noise.min(), noise.max()) == pytest.approx(drawing.NOISE, rel=0.1)
    rounded = noise == LEVEL / np.sqrt(12)
    assert 0.2 < rounded.mean() < 0.3
    scaled = error / noise[:, None]
    for kind in (rounded, ~rounded):
        assert np.sqrt(np.square(scaled[kind]).mean()) == pytest.approx(np.sqrt(1 + drawing.REST_SHARE**2), rel=0.02)
    # What a clip's frames share is the error of the rest position, and rounding stays within half a step of it.
    shared = np.hypot(drawing.REST_SHARE, 1 / np.sqrt(SLOTS))
    assert scaled[~rounded].mean(axis=1).std() == pytest.approx(shared, rel=0.05)
    assert np.abs(error[rounded]).max() < LEVEL / 2 + 5 * drawing.REST_SHARE * LEVEL / np.sqrt(12)


def test_half_of_the_windows_end_under_the_tool() -> None:
    """And a fifth of them anywhere; all lengths from two slots on are equally likely."""
    assert drawing.CUT_SHARES == (0.5, 0.2)
    loads = np.repeat([1, 6, 12], 4000)
    known = drawing.draw_known((np.arange(SLOTS) < loads[:, None]).astype(float), np.random.default_rng(0))
    assert (np.diff(known, axis=1) <= 0).all()
    lengths = known.sum(axis=1).astype(int)
    assert lengths.min() == 2
    for load in (1, 6, 12):
        longest = max(load, 2)  # a shorter window is too early for an estimate
        expected = np.zeros(SLOTS + 1)
        expected[2 : longest + 1] = 0.5 / (longest - 1)
        expected[2:] += 0.2 / (SLOTS - 1)
        expected[SLOTS] += 0.3
        found = np.bincount(lengths[loads == load], minlength=SLOTS + 1) / 4000
        np.testing.assert_allclose(found, expected, atol=0.03)  # √(0.25/4000) = 0.008


def test_a_wider_noise_level_tells_less(contacts: list[SimulatedContact]) -> None:
    logs = np.log(np.abs(contacts[0].theta))
    contact = contacts[0].interaction
    narrow, wide = (contact_training.widened(contact, blur).linearise(logs) for blur in (0.1, 0.2))
    np.testing.assert_allclose(narrow.information, 4 * wide.information, rtol=1e-6)


@pytest.fixture(scope="module")
def fits(contacts: list[SimulatedContact]) -> Fits:
    """Around what explains each, found from the truth."""
    tasks = [(contact.interaction, np.log(np.abs(contact.theta)), FRAME_S) for contact in contacts]
    return Fits.of([task[0] for task in tasks], list(map(fit_sequence, tasks)), [FRAME_S] * len(tasks))


def new_posterior() -> ContactPosterior:
    return ContactPosterior(SimulatedContacts.contact_features, torch.tensor(RECOMMENDED.log_box))


def descended(network: torch.nn.Module, loss: Callable[[], torch.Tensor], steps: int) -> None:
    """Descend as the training does."""
    optimizer = torch.optim.AdamW(network.parameters(), 2e-3, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 2e-3, total_steps=steps, pct_start=0.1)
    for _ in range(steps):
        optimizer.zero_grad()
        loss().backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        schedule.step()


@pytest.mark.acceptance
def test_the_fine_stage_learns(fits: Fits, monkeypatch: pytest.MonkeyPatch) -> None:
    """On four contacts, two hundred steps bring the estimates nearer to what explains the motions.

    Those that were observed for a second: most windows that end under the tool tell too little to come near.
    """
    posterior = new_posterior()
    generator = np.random.default_rng(1)
    with monkeypatch.context() as patch:
        patch.setattr(drawing, "draw_known", lambda loaded, _: np.ones_like(loaded))
        held_out = draw_observed(fits, 400, np.random.default_rng(5))

    def error() -> float:
        with torch.no_grad():
            mean = posterior(torch.from_numpy(held_out.features))[0].double().numpy()
        return float(np.sqrt(np.square(mean - held_out.logs).mean()))

    before = error()
    descended(posterior, lambda: contact_module.fine_loss(posterior, draw_observed(fits, 64, generator)), 200)
    assert error() < 0.5 * before


@pytest.mark.acceptance
def test_the_expected_bound_learns_and_leaves_the_posterior_alone(fits: Fits) -> None:
    """On four contacts, four hundred steps tell how well each was observed, under noise that was not drawn before.

    Half as many are enough for contacts that were observed to their end.
    """
    posterior = new_posterior()
    generator = np.random.default_rng(1)
    drawn = draw_observed(fits, 400, np.random.default_rng(5))
    features, true = torch.from_numpy(drawn.features), bounds(drawn.information)

    def told() -> tuple[torch.Tensor, torch.Tensor, np.ndarray]:
        with torch.no_grad():
            bound = posterior.expected_bound_factor(features).double().numpy()
            return *posterior(features), np.linalg.norm(bound, axis=2)

    mean, factor, before = told()
    bound, loss = posterior.expected_bound, contact_module.expected_loss
    descended(bound, lambda: loss(posterior, draw_observed(fits, 64, generator)), 400)
    same_mean, same_factor, expected = told()
    off = [np.median(np.abs(np.log(each / true))[true < LIMIT]) for each in (before, expected)]
    assert off[1] < 0.5 * off[0]
    assert torch.equal(mean, same_mean)
    assert torch.equal(factor, same_factor)
    clear = np.abs(np.log(true / LIMIT)) > np.log(1.5)
    assert ((expected < LIMIT) == (true < LIMIT))[clear].mean() > 0.93
    assert 0.2 < (true < LIMIT)[clear].mean() < 0.85  # a guess would be wrong more often


@pytest.fixture(scope="module")
def drawn() -> list[SimulatedContact]:
    return make_contacts(24, 3, 0)


def test_contacts_are_of_every_regime(drawn: list[SimulatedContact]) -> None:
    """In turn by scene, as in the benchmark."""
    regimes = [regime_of(damping_ratio(*contact.theta[:2], drawing.SCENES.mass)) for contact in drawn]
    assert regimes == ["under-damped"] * 8 + ["critical"] * 8 + ["over-damped"] * 8


def explained(contacts: list[SimulatedContact], workers: int) -> Fits:
    """What explains contacts, from the middle of the box."""
    data = SimulatedContacts(workers=workers)
    parts = [(contact.interaction, within) for contact, within in zip(contacts, MADE, strict=True)]
    data.made = [Made(contact, contact_surroundings(contact), within) for contact, within in parts]
    return data.explained(np.tile(RECOMMENDED.log_box.mean(axis=0), (len(contacts), 1)))


@pytest.mark.slow
def test_contacts_and_fits_are_the_same_in_processes_of_their_own(drawn, unsure: list[SimulatedContact]) -> None:
    """Equal to the last bit, and in order: a training does not depend on how many cores there are."""
    there = make_contacts(12, 3, 2)
    assert len(there) == 16  # the first two scenes
    for one, other in zip(drawn[:16], there, strict=True):
        assert np.array_equal(one.theta, other.theta)
        assert np.array_equal(one.interaction.moved, other.interaction.moved)
        assert np.array_equal(one.interaction.mesh.vertices, other.interaction.mesh.vertices)
    fits, same = (explained(unsure, workers) for workers in (0, 1))
    assert fits.logs.shape == (2, 5)
    assert fits.within.tolist() == [0.0, FRAME_S]
    for field in dataclasses.fields(Fits):
        np.testing.assert_array_equal(getattr(fits, field.name), getattr(same, field.name))


@pytest.mark.parametrize(
    ("option", "value", "reason"),
    [
        ("contacts", 0, "contacts is 0; give 1 or more"),
        ("rough_steps", 3, "rough_steps is 3; give 4 or more"),
        ("fine_steps", 3, "fine_steps is 3; give 4 or more"),
        ("bound_steps", 3, "bound_steps is 3; give 4 or more"),
        ("seed", -1, "seed is -1; give 0 or more"),
        ("seed", 2**63, r"seed is a number beyond ±1e\+15; give 0 or more\."),
        ("workers", -1, "workers is -1; give 0 to 1024"),
    ],
)
def test_numbers_that_would_end_a_training_late_are_refused_at_once(option, value, reason) -> None:
    with pytest.raises(ValueError, match=reason):
        SimulatedContacts(**{option: value})


@pytest.mark.parametrize(
    ("option", "reason"),
    [
        ("data.contacts=0", "contacts is 0; give 1 or more"),
        ("data.contacts=many", "--data.contacts: Expected a <class 'int'>"),
        ("data.contac=3", "--data.contac is not accepted"),
        ("trainer.max_epochs=2", "trainer.max_epochs is 2, and each epoch is a stage of the training; give 3."),
    ],
)
def test_options_that_can_t_be_followed_get_a_sentence(option, reason, tmp_path, capsys) -> None:
    given = ["fit", "-c", str(CONFIG), "--tracking=false", f"--trainer.default_root_dir={tmp_path / 'out'}"]
    assert train.main([*given, f"--{option}"]) == 2
    assert reason in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def fitted(unsure: list[SimulatedContact]) -> list[Fitted]:
    middle = RECOMMENDED.log_box.mean(axis=0)
    return [fit_sequence((unsure[index].interaction, middle, within)) for index, within in enumerate(MADE)]


@pytest.fixture
def made(unsure: list[SimulatedContact], fitted: list[Fitted], monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """How well instants are known of contacts that were asked for: what is drawn and fitted is there, steps are few."""
    asked = []

    def make(*given) -> list[SimulatedContact]:
        asked.append(given[-1])
        return [unsure[given[-1] > 0]]

    monkeypatch.setattr(contact_training, "make_contacts", make)
    monkeypatch.setattr(drawing, "fit_sequence", lambda task: fitted[task[2] > 0])
    monkeypatch.setattr(contact_training, "ROUGH_BATCH", 8)
    monkeypatch.setattr(contact_training, "FINE_BATCH", 32)
    return asked


def short(folder: Path, *options: str) -> int:
    settings = {"trainer.default_root_dir": folder, "trainer.log_every_n_steps": 1, "tracking": "false"}
    settings |= dict.fromkeys(("trainer.enable_progress_bar", "trainer.enable_model_summary"), "false")
    settings |= {f"data.{name}_steps": 4 for name in contact_module.STAGES} | {"data.workers": 0}
    return train.main(["fit", "-c", str(CONFIG), *(f"--{name}={value}" for name, value in settings.items()), *options])


def logged(folder: Path) -> dict[str, int]:
    """Number of losses of each stage in the last log."""
    rows = read_rows(sorted((folder / "logs").iterdir())[-1] / "metrics.csv")
    losses = ((stage, row.get(f"{stage}/loss")) for row in rows for stage in contact_module.STAGES)
    found = [stage for stage, loss in losses if loss]
    return {stage: found.count(stage) for stage in dict.fromkeys(found)}


def test_a_training_leaves_its_weights_and_its_record(made, tmp_path, capsys) -> None:
    assert short(tmp_path) == 0
    assert made == MADE
    assert sorted(path.name for path in tmp_path.iterdir()) == [LIST, "checkpoints", "logs", "posterior.pt"]
    assert logged(tmp_path) == {"rough": 4, "fine": 4, "bound": 4}
    weights = tmp_path / "posterior.pt"
    found = torch.load(weights, weights_only=True)
    assert found["entry.weight"].shape[1] == FEATURES + SEQUENCE_FEATURES
    assert all(torch.isfinite(values).all() for values in found.values())
    before = weights.read_bytes()
    assert short(tmp_path) == 2
    assert "holds a training already; add --ckpt_path last to go on with it" in capsys.readouterr().err
    assert weights.read_bytes() == before


def test_a_user_s_file_is_named_and_stays(made, tmp_path, capsys) -> None:
    (tmp_path / "posterior.pt").write_text("precious")
    assert short(tmp_path) == 1
    assert "posterior.pt is not as this program wrote it" in " ".join(capsys.readouterr().err.split())
    assert (tmp_path / "posterior.pt").read_text() == "precious"
    assert not (tmp_path / "checkpoints").exists()


@pytest.mark.parametrize(
    ("error", "status", "told"),
    [
        (KeyboardInterrupt(), INTERRUPTED, "Interrupted. Add --ckpt_path last"),
        (WorkerLost("A worker was killed."), 1, "train.py: A worker was killed."),
        (OSError(28, "The disk is full"), 1, "train.py: The run folder: The disk is full; make room"),
    ],
)
def test_what_ends_a_training_is_one_sentence_and_it_goes_on(error, status, told, made, tmp_path, capsys) -> None:
    """After the last finished stage."""

    def fail(*_: object) -> None:
        raise error

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(contact_module, "fine_loss", fail)
        assert short(tmp_path) == status
    caught = "".join(capsys.readouterr())
    assert told in caught
    assert "Traceback" not in caught
    assert not (tmp_path / "posterior.pt").exists()
    assert short(tmp_path, "--ckpt_path=last") == 0
    assert logged(tmp_path) == {"fine": 4, "bound": 4}
    assert (tmp_path / "posterior.pt").is_file()


def test_nothing_to_train_on_is_told(unsure: list[SimulatedContact], fitted: list[Fitted], monkeypatch) -> None:
    monkeypatch.setattr(drawing, "fit_sequence", lambda task: fitted[task[2] > 0])
    monkeypatch.setattr(drawing, "EXPLAINED", -1.0)
    with pytest.raises(contact_training.TrainingError, match="No motion could be explained"):
        explained(unsure, 0)
    monkeypatch.setattr(drawing, "draw_contacts", lambda *_, **__: [])
    with pytest.raises(contact_training.TrainingError, match="No contact could be drawn"):
        make_contacts(8, 0, 0)
