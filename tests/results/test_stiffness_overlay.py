"""A map of stiffness on the video: where it is known, where the tissue is by then, and nowhere else."""

import dataclasses

import numpy as np

from palpate.data.labels import TISSUE, TOOL
from palpate.estimators.grip.grip_estimate import GripEstimate
from palpate.estimators.grip.stiffness_fit import StiffnessField
from palpate.results.field_overlay import OPACITY, colors
from palpate.results.stiffness_overlay import DARKENED, KNOWN, LOOSE, UNKNOWN, stiffness_map

HEIGHT, WIDTH = 96, 192
GREY = 100
START = 2.0
PULL = 24.0
"""How far all tissue goes to the right at last [px]."""


def field_of(known: bool = True) -> StiffnessField:
    """Two columns of knots: soft at 48 px, stiff at 144 px, and the left half known, or nothing."""
    log, low, extent = np.log([0.5, 0.5, 2.0, 2.0]), np.array([48.0, 16.0]), np.array([96.0, 64.0])
    sure = np.diag([0.01, 0.01, 0.01, 0.01]) if known else 9 * np.eye(4)
    moving = np.array([[48.0, 48.0], [144.0, 48.0]])
    picture = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    return StiffnessField((2, 2), low, extent, log, sure, 9 * np.eye(4), 0.0, moving, 0.0, picture)


def grip_of(field: StiffnessField) -> GripEstimate:
    times = np.array([0.5, 1.0])
    points = np.stack(np.meshgrid(np.arange(4.0, WIDTH, 8), np.arange(4.0, HEIGHT, 8)), axis=-1).reshape(-1, 2)
    moved = np.zeros((2, len(points), 2), np.float32)
    moved[:, :, 0] = PULL * times[:, None]
    moved[1, ::5] = np.nan
    return GripEstimate(
        0.02, 0.015, 0.027, 0.6, 0.1, times, times, np.zeros(2), 300.0, 270.0, 330.0, field, points, moved
    )


def drawn(time: float, grip: GripEstimate, labels: np.ndarray, enlarged: int = 1) -> np.ndarray:
    canvas = np.full((enlarged * HEIGHT, enlarged * WIDTH, 3), GREY, np.uint8)
    found = stiffness_map(grip, START)
    found.draw(canvas, time, labels)
    return canvas


def mixed(log: float) -> np.ndarray:
    return OPACITY * colors(np.array([log]))[0] + (1 - OPACITY) * GREY


TISSUE_ALONE = np.full((HEIGHT, WIDTH), TISSUE, np.uint8)


def test_what_is_known_is_coloured_and_the_rest_is_dark() -> None:
    shown = drawn(START, grip_of(field_of()), TISSUE_ALONE)
    # Between 48 and 144 px log stiffness runs from half to twice the mean, and squares are 16 px wide.
    np.testing.assert_allclose(shown[48, 54], mixed(-0.9), atol=16)
    np.testing.assert_allclose(shown[48, 138], mixed(0.9), atol=16)
    assert shown[48, 54, 2] > shown[48, 54, 0]
    assert shown[48, 138, 0] > shown[48, 138, 2]
    for row, column in ((48, 20), (48, 170), (5, 96), (90, 96)):
        np.testing.assert_array_equal(shown[row, column], DARKENED * GREY)


def test_it_goes_with_the_tissue() -> None:
    """Half-way between the frames that were kept as well, from rest on; points that are lost don't count."""
    grip = grip_of(field_of())
    for since in (0.25, 0.5, 0.75, 1.0):
        shown = drawn(START + since, grip, TISSUE_ALONE)
        covered = np.flatnonzero((shown[48] != DARKENED * GREY).any(axis=1))
        assert abs(covered[0] - (48 + PULL * since)) <= 1
        assert abs(covered[-1] - (144 + PULL * since)) <= 1


def test_a_larger_picture_shows_the_same() -> None:
    small, large = (drawn(START + 0.5, grip_of(field_of()), TISSUE_ALONE, size) for size in (1, 3))
    apart = np.abs(large[1::3, 1::3].astype(int) - small.astype(int)).max(axis=2)
    assert (apart > 12).mean() < 0.03  # the ends of what is painted


def test_instruments_stay_as_they_are() -> None:
    labels = TISSUE_ALONE.copy()
    labels[40:56, 60:100] = TOOL
    labels[:, :10] = TOOL
    shown = drawn(START, grip_of(field_of()), labels)
    assert (shown[41:55, 61:99] == GREY).all()
    assert (shown[:, :9] == GREY).all()


def test_a_map_says_whether_it_is_determined_and_shows_what_is_known_during_the_motion() -> None:
    sure, loose = stiffness_map(grip_of(field_of()), START), grip_of(dataclasses.replace(field_of(), excess=0.3))
    assert sure.note == KNOWN
    assert [sure.shows(time) for time in (1.9, 2.0, 2.7, 3.0, 3.1)] == [False, True, True, True, False]
    assert stiffness_map(loose, START).note == f"{KNOWN} {LOOSE}"
    unknown = grip_of(field_of(known=False))
    assert stiffness_map(unknown, START).note == UNKNOWN
    assert (drawn(START + 0.5, unknown, TISSUE_ALONE) == GREY).all()
    without = ({"stiffness": None}, {"points": np.empty((0, 2))})
    for grip in (None, *(dataclasses.replace(grip_of(field_of()), **lack) for lack in without)):
        assert stiffness_map(grip, START) is None
