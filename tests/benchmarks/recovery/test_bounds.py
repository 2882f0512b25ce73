"""What a contact could tell at best: of its point and of its dent, with known and with unknown instants."""

import dataclasses
import functools

import numpy as np
import pytest

from benchmarks.recovery import bounds as limits
from palpate.data.contact.depth_sequence import REACH, DepthSequence, SequenceNoise
from palpate.data.contact.interaction import Interaction
from palpate.data.contact.patches import Patches
from palpate.data.synthetic.clip import draw_truth
from palpate.data.synthetic.scene import Scene
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.truth import PressedMotion
from palpate.estimators.direct.patch import PatchMotion
from palpate.estimators.onset import BETWEEN, STAMP
from palpate.physics import Observation, Press, PressShape, contact_normal, held
from palpate.physics.identifiability import bounds, box_information, fisher_information
from palpate.physics.mechanics import RECOMMENDED, theta_of
from palpate.physics.msd.simulation import simulate
from tests.estimators.direct.test_shading_problem import FRAME_S, lit_contact

SIGMA = 1e-3
SETTINGS = SceneSettings(
    width=214, height=120, frames=12, press_seconds=(0.16, 0.16), onset_fraction=(0.2, 0.25), regime="critical",
    onset_delay=(0.3, 0.3), release_delay=(0.6, 0.6),
)  # fmt: skip
SIDE = 2 * REACH + 1


@functools.cache
def truth() -> tuple[Scene, PressedMotion]:
    return draw_truth(SETTINGS, 3)


def contact_of(
    aside: tuple[int, int] = (0, 0), *, released: bool = True, noise: SequenceNoise | None = None
) -> Interaction:
    """The true contact as it would be observed without errors, found so many rows and columns beside where it is."""
    scene, motion = truth()
    mesh = scene.mesh
    pixel = mesh.pixels[scene.vertex] + aside
    vertex = int(np.flatnonzero((mesh.pixels == pixel).all(axis=1))[0])
    until = len(motion.times) if released else motion.release_frame
    frames = np.arange(motion.onset_frame + 1, until)
    times = motion.times[frames] - motion.times[motion.onset_frame]
    steps = (motion.release_frame - motion.onset_frame) / SETTINGS.fps / limits.MECHANICS.time_step
    load = held(steps if released else limits.MECHANICS.steps, limits.MECHANICS.steps)
    whole = np.zeros((len(frames), len(mesh.vertices), 3))
    whole[:, motion.moving] = motion.field[frames]
    patches = Patches(mesh, vertex, (214, 120))
    moved = whole[:, patches.vertices]
    change = patches.shown(patches.sunk(moved), patches.covering(moved)).reshape(-1, SIDE, SIDE).astype(np.float32)
    return Interaction(
        mesh,
        Press.at(vertex, contact_normal(mesh, vertex), load),
        Observation.of_point(vertex, times, motion.contact[frames], SIGMA),
        limits.MECHANICS.time_step,
        DepthSequence(times, change, noise or SequenceNoise(SIGMA, 0.0), (214, 120)),
    )


@pytest.fixture(scope="module")
def found() -> tuple[np.ndarray, np.ndarray]:
    """Information of the contact for SIGMA, and of the field."""
    field = limits.field_information(contact_of(), *truth())
    assert field is not None
    return limits.contact_information(contact_of(), *truth()) / SIGMA**2, field


def true_path(logs: np.ndarray, observed: Observation) -> np.ndarray:
    """Displacement of the contact for log θ and both delays in frames, shape [N, 3], with steps of 1/64 ms each."""
    scene, motion = truth()
    fine = dataclasses.replace(
        limits.MECHANICS, time_step=limits.MECHANICS.time_step / 16, steps=16 * 160, window_error=1e-7
    )
    frame = 1 / SETTINGS.fps
    load = (motion.release_frame - motion.onset_frame + logs[4] - logs[3]) * frame
    press = Press.at(scene.vertex, scene.direction, held(load / fine.time_step, fine.steps))
    path = simulate(theta_of(logs[:3]), scene.mesh, press, fine, dtype=np.float64)
    path, after = np.concatenate([np.zeros((1, 3)), path]), fine.time_step * np.arange(fine.steps + 1)
    since = observed.times - logs[3] * frame
    return np.stack([np.interp(since, after, column) for column in path.T], axis=1)


@pytest.mark.slow
def test_contact_information_is_that_of_the_motion_at_the_truth() -> None:
    """Against central differences of the simulator with much finer steps."""
    _, motion = truth()
    contact = contact_of()
    logs = np.concatenate([np.log(np.abs(motion.theta)), [0.3, 0.6]])
    np.testing.assert_allclose(true_path(logs, contact.observation), contact.moved, atol=3e-4)
    columns = [
        (true_path(logs + step, contact.observation) - true_path(logs - step, contact.observation)) / 0.04
        for step in 0.02 * np.eye(5)
    ]
    expected = fisher_information(np.stack(columns, axis=-1), 1.0)
    information = limits.contact_information(contact, *truth())
    assert information.shape == (5, 5)
    sizes = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(information / sizes, expected / sizes, atol=0.02)


def test_information_is_symmetric_and_positive_and_a_dent_tells_more_than_its_deepest_point(found) -> None:
    for information in found:
        assert information.shape == (5, 5)
        np.testing.assert_allclose(information, information.T, rtol=1e-9)
        assert (np.linalg.eigvalsh(information) > 0).all()
    for onset in (STAMP, BETWEEN):
        contact, field = (bounds(limits.known(information, onset)) for information in found)
        assert (field < contact).all()
        assert (field > 0).all()


def test_the_sequences_noise_counts(found: tuple[np.ndarray, np.ndarray]) -> None:
    """Independent errors of twice the size tell a quarter."""
    larger = limits.field_information(contact_of(noise=SequenceNoise(2 * SIGMA, 0.0)), *truth())
    np.testing.assert_allclose(larger, found[1] / 4, rtol=1e-6)
    alike = limits.field_information(contact_of(noise=SequenceNoise(SIGMA, 0.0, 4.0)), *truth())
    for less in (larger, alike):
        assert np.linalg.eigvalsh(found[1] - less).min() > -1e-6 * np.abs(found[1]).max()


def test_what_was_observed_itself_does_not_count(found: tuple[np.ndarray, np.ndarray]) -> None:
    """Only when, and what was hidden, does."""
    contact = contact_of()
    generator = np.random.default_rng(0)
    sequence = contact.sequence
    noisy = sequence.change + generator.normal(0, SIGMA, sequence.change.shape).astype(np.float32)
    spoiled = dataclasses.replace(
        contact,
        sequence=dataclasses.replace(sequence, change=noisy),
        observation=contact.observation.moved(contact.moved + 0.01, 7.0),
    )
    np.testing.assert_allclose(limits.field_information(spoiled, *truth()), found[1], rtol=1e-9)
    np.testing.assert_allclose(limits.contact_information(spoiled, *truth()) / SIGMA**2, found[0], rtol=1e-9)


@pytest.mark.parametrize("aside", [(0, 1), (-1, 0), (1, -1)])
def test_the_sequence_of_a_contact_found_one_pixel_aside_is_recentred(aside: tuple[int, int]) -> None:
    """It tells what the true contact's does without the rows and columns that it doesn't show."""
    contact = contact_of()
    change = contact.sequence.change.copy()
    for axis, away in enumerate(aside):
        if away:
            lost = [slice(None)] * 3
            lost[1 + axis] = slice(None, away) if away > 0 else slice(away, None)
            change[tuple(lost)] = np.nan
    cut = dataclasses.replace(contact, sequence=dataclasses.replace(contact.sequence, change=change))
    expected = limits.field_information(cut, *truth())
    np.testing.assert_allclose(limits.field_information(contact_of(aside), *truth()), expected, rtol=1e-9)


def test_a_tool_takes_what_it_hides_from_the_right_pixels() -> None:
    """Hidden in the middle of the true contact, wherever the depth-change sequence's own middle is."""
    found = []
    for aside in ((0, 0), (1, 1)):
        contact = contact_of(aside)
        change = contact.sequence.change.copy()
        change[:, REACH - aside[0], REACH - aside[1]] = np.nan
        if aside == (0, 0):
            change[:, 0], change[:, :, 0] = np.nan, np.nan
        sequence = dataclasses.replace(contact.sequence, change=change)
        found.append(limits.field_information(dataclasses.replace(contact, sequence=sequence), *truth()))
    np.testing.assert_allclose(found[0], found[1], rtol=1e-9)


def test_where_the_release_was_not_seen_nothing_is_known_of_it() -> None:
    contact = contact_of(released=False)
    for information in (limits.contact_information(contact, *truth()), limits.field_information(contact, *truth())):
        assert information.shape == (5, 5)
        np.testing.assert_array_equal(information[4], 0)
        np.testing.assert_array_equal(information[:, 4], 0)
        assert (np.diag(information)[:4] > 0).all()
        assert np.isfinite(limits.known(information, BETWEEN)).all()


def test_without_a_sequence_there_is_no_information_of_it() -> None:
    contact = contact_of()
    assert limits.field_information(dataclasses.replace(contact, sequence=None), *truth()) is None
    short = dataclasses.replace(contact, sequence=contact.sequence.chosen(np.arange(2)))
    assert limits.field_information(short, *truth()) is None


def test_unknown_instants_are_even_within_a_frame() -> None:
    """What is left is the block of the covariance, with the variance of an even spread from -1 to 1 before."""
    slopes = np.random.default_rng(1).normal(size=(4, 3, 20, 5))
    information = np.einsum("abkp,abkq->abpq", slopes, slopes)
    stamped, between = limits.known(information, STAMP), limits.known(information, BETWEEN)
    np.testing.assert_array_equal(stamped, information[..., :3, :3])
    weighed = information + np.diag([0, 0, 0, 3, 3])
    assert between.shape == (4, 3, 3, 3)
    np.testing.assert_allclose(np.linalg.inv(between), np.linalg.inv(weighed)[..., :3, :3], rtol=1e-8)


def test_unknown_instants_never_tell_more(found: tuple[np.ndarray, np.ndarray]) -> None:
    slopes = np.random.default_rng(2).normal(size=(50, 6, 5)) * [1.0, 2.0, 0.5, 10.0, 0.01]
    for information in (*found, *np.einsum("akp,akq->apq", slopes, slopes)):
        less = limits.known(information, STAMP) - limits.known(information, BETWEEN)
        assert np.linalg.eigvalsh(less).min() > -1e-9 * np.abs(information).max()
    assert (bounds(limits.known(found[1], BETWEEN)) > bounds(limits.known(found[1], STAMP))).all()


def test_who_does_not_know_the_shape_of_a_press_knows_less_of_its_tissue() -> None:
    """Against the same press whose shape is known, and a brute-force derivative by its parameters."""
    scene, motion = truth()
    shape = PressShape(2.5, (0.0, 0.0), 0.03, 0.04, (0.1, 0.05))
    pressed = dataclasses.replace(motion, shape=shape)
    found = limits.contact_information(contact_of(), scene, pressed)
    within = 1 / SETTINGS.fps
    contact = dataclasses.replace(contact_of(), mesh=scene.mesh)
    watch = PatchMotion(contact, limits.MECHANICS, np.array([scene.vertex]), contact.observation.times, within)
    logs = np.concatenate([np.log(np.abs(motion.theta)), np.array([motion.delay, motion.release_delay]) / within])
    slopes = watch.at(watch.parameters(logs, shape))[1].reshape(-1, 12)
    information = slopes.T @ slopes + SIGMA**2 * box_information(watch.box(RECOMMENDED.log_box)) * ([0] * 5 + [1] * 7)
    np.testing.assert_allclose(np.linalg.inv(found), np.linalg.inv(information)[:5, :5], rtol=1e-4)
    assert (bounds(found) > 1.02 * bounds(slopes[:, :5].T @ slopes[:, :5])).all()


def test_light_tells_less_where_it_is_noisier_and_more_of_a_deeper_dent():
    theta = np.array([0.6, 0.05, -0.03])
    least = bounds(limits.light_information(lit_contact(0.02), theta, FRAME_S))
    noisier = bounds(limits.light_information(lit_contact(0.04), theta, FRAME_S))
    # The law's own parameters have priors, which no noise touches.
    assert (noisier > 1.5 * least).all()
    assert (noisier < 2 * least).all()
    deeper = bounds(limits.light_information(lit_contact(0.02), theta * [1, 1, 1.5], FRAME_S))
    assert (deeper[:2] < least[:2]).all()
