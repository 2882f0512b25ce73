"""What a contact could tell at best: of its dent, with known and with unknown instants."""

import dataclasses
import functools

import numpy as np
import pytest

from benchmarks.recovery import bounds as limits
from palpate.data.contact.interaction import Interaction
from palpate.data.synthetic.clip import draw_truth
from palpate.data.synthetic.scene import Scene
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.truth import PressedMotion
from palpate.estimators.onset import BETWEEN, STAMP
from palpate.physics import Observation, Press, contact_normal, held
from palpate.physics.depth import REACH, DepthSequence, SequenceNoise
from palpate.physics.identifiability import bounds
from palpate.physics.patches import Patches

SIGMA = 1e-3
SETTINGS = SceneSettings(
    width=214, height=120, frames=12, press_seconds=(0.16, 0.16), onset_fraction=(0.2, 0.25), regime="critical",
    onset_delay=(0.3, 0.3), release_delay=(0.6, 0.6),
)  # fmt: skip
SIDE = 2 * REACH + 1


@functools.cache
def truth() -> tuple[Scene, PressedMotion]:
    return draw_truth(SETTINGS, 3)


def contact_of(aside=(0, 0), *, released: bool = True, noise: SequenceNoise | None = None) -> Interaction:
    """The true contact as it would be observed without errors, found so many rows and columns beside where it is."""
    scene, motion = truth()
    mesh = scene.mesh
    pixel = mesh.pixels[scene.vertex] + aside
    vertex = int(np.flatnonzero((mesh.pixels == pixel).all(axis=1))[0])
    until = len(motion.times) if released else motion.release_frame
    frames = np.arange(motion.onset_frame + 1, until)
    times = motion.times[frames] - motion.times[motion.onset_frame]
    steps = (motion.release_frame - motion.onset_frame) / SETTINGS.fps / limits.FITTED.time_step
    load = held(steps if released else limits.FITTED.steps, limits.FITTED.steps)
    whole = np.zeros((len(frames), len(mesh.vertices), 3))
    whole[:, motion.moving] = motion.field[frames]
    patches = Patches(mesh, vertex, (214, 120))
    moved = whole[:, patches.vertices]
    change = patches.shown(patches.sunk(moved), patches.covering(moved)).reshape(-1, SIDE, SIDE).astype(np.float32)
    return Interaction(
        mesh,
        Press.at(vertex, contact_normal(mesh, vertex), load),
        {
            "point": Observation.of_point(vertex, times, motion.contact[frames], SIGMA),
            "depth": DepthSequence(times, change, noise or SequenceNoise(SIGMA, 0.0), (214, 120)),
        },
        limits.FITTED.time_step,
    )


@pytest.fixture(scope="module")
def found() -> np.ndarray:
    """Information of the dent."""
    field = limits.field_information(contact_of(), *truth())
    assert field is not None
    return field


def test_information_is_symmetric_and_positive(found: np.ndarray) -> None:
    assert found.shape == (5, 5)
    np.testing.assert_allclose(found, found.T, rtol=1e-9)
    assert (np.linalg.eigvalsh(found) > 0).all()


def test_the_sequences_noise_counts(found: np.ndarray) -> None:
    """Independent errors of twice the size tell a quarter."""
    larger = limits.field_information(contact_of(noise=SequenceNoise(2 * SIGMA, 0.0)), *truth())
    np.testing.assert_allclose(larger, found / 4, rtol=1e-6)
    alike = limits.field_information(contact_of(noise=SequenceNoise(SIGMA, 0.0, 4.0)), *truth())
    for less in (larger, alike):
        assert np.linalg.eigvalsh(found - less).min() > -1e-6 * np.abs(found).max()


def test_what_was_observed_itself_does_not_count(found: np.ndarray) -> None:
    """Only when, and what was hidden, does."""
    contact = contact_of()
    generator = np.random.default_rng(0)
    sequence = contact.sequence
    noisy = sequence.change + generator.normal(0, SIGMA, sequence.change.shape).astype(np.float32)
    spoiled = contact.having(
        depth=dataclasses.replace(sequence, change=noisy), point=contact.observation.moved(contact.moved + 0.01, 7.0)
    )
    np.testing.assert_allclose(limits.field_information(spoiled, *truth()), found, rtol=1e-9)


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
    cut = contact.having(depth=dataclasses.replace(contact.sequence, change=change))
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
        found.append(limits.field_information(contact.having(depth=sequence), *truth()))
    np.testing.assert_allclose(found[0], found[1], rtol=1e-9)


def test_where_the_release_was_not_seen_nothing_is_known_of_it() -> None:
    contact = contact_of(released=False)
    information = limits.field_information(contact, *truth())
    assert information.shape == (5, 5)
    np.testing.assert_array_equal(information[4], 0)
    np.testing.assert_array_equal(information[:, 4], 0)
    assert (np.diag(information)[:4] > 0).all()
    assert np.isfinite(limits.known(information, BETWEEN)).all()


def test_without_a_sequence_there_is_no_information_of_it() -> None:
    contact = contact_of()
    assert limits.field_information(contact.having(depth=None), *truth()) is None
    short = contact.having(depth=contact.sequence.chosen(np.arange(2)))
    assert limits.field_information(short, *truth()) is None


def test_unknown_instants_are_even_within_a_frame() -> None:
    """The rest is the block of the covariance, with the variance of an even spread from -1 to 1 before."""
    slopes = np.random.default_rng(1).normal(size=(4, 3, 20, 5))
    information = np.einsum("abkp,abkq->abpq", slopes, slopes)
    stamped, between = limits.known(information, STAMP), limits.known(information, BETWEEN)
    np.testing.assert_array_equal(stamped, information[..., :3, :3])
    weighed = information + np.diag([0, 0, 0, 3, 3])
    assert between.shape == (4, 3, 3, 3)
    np.testing.assert_allclose(np.linalg.inv(between), np.linalg.inv(weighed)[..., :3, :3], rtol=1e-8)


def test_unknown_instants_never_tell_more(found: np.ndarray) -> None:
    slopes = np.random.default_rng(2).normal(size=(50, 6, 5)) * [1.0, 2.0, 0.5, 10.0, 0.01]
    for information in (found, *np.einsum("akp,akq->apq", slopes, slopes)):
        less = limits.known(information, STAMP) - limits.known(information, BETWEEN)
        assert np.linalg.eigvalsh(less).min() > -1e-9 * np.abs(information).max()
    assert (bounds(limits.known(found, BETWEEN)) > bounds(limits.known(found, STAMP))).all()
