"""A sheet of one number, and how well models predict later frames."""

import numpy as np
import pytest

from palpate.estimators.grip.lattice import GripFrame, NothingMoves
from palpate.estimators.online.forecast import MOST_FRAMES, RATIOS, Lattice, prediction_skill, telling

SPACING = 8
RNG = np.random.default_rng(5)
SHAPE, MISSED = RNG.normal(size=(2, 40, 2))
WAY = np.array([1.0, 2.0, 3.0, 5.0, 9.0])


def square() -> Lattice:
    """Points on a grid beside a tool at the left."""
    points = SPACING * np.stack(np.meshgrid(np.arange(1, 15), np.arange(1, 12)), axis=-1).reshape(-1, 2).astype(float)
    return Lattice(points, SPACING, points[:, 0])


def pulled(lattice: Lattice, way: float) -> GripFrame:
    """The tool's points moved, the others unknown as yet."""
    gripped = lattice.distance < 24
    return GripFrame(np.where(gripped[:, None], [way, 0.5 * way], 0.0), gripped)


def test_a_sheet_s_ratio_is_found_from_its_own_motion() -> None:
    lattice = square()
    for ratio in RATIOS[[4, 8, 12]]:
        frames = []
        for way in (0.1, 6.0, 9.0):  # in the first nothing moves to speak of
            frame = pulled(lattice, way)
            frames.append(GripFrame(lattice.motion(frame, ratio), frame.gripped))
        assert lattice.ratio(frames) == ratio
    with pytest.raises(NothingMoves, match="in none of 1 frames"):
        lattice.ratio([pulled(lattice, 0.1)])


def test_a_sheet_leaves_out_what_is_not_seen() -> None:
    lattice = square()
    frame = pulled(lattice, 8.0)
    frame.moved[-3:] = np.nan
    moved = lattice.motion(frame, 1.0)
    assert np.isnan(moved[-3:]).all()
    np.testing.assert_allclose(moved[frame.gripped], frame.moved[frame.gripped])
    lengths = np.linalg.norm(moved[:-3], axis=1)
    assert lengths[lattice.distance[:-3] > 100].max() < 0.3 * lengths.max()


def grown(way: np.ndarray, share: float = 1.0) -> np.ndarray:
    """Motion [T, 40, 2] of which a model misses a part that grows with the way, as steeply as a share says."""
    return way[:, None, None] * SHAPE + (1 + share * (way[:, None, None] - 1)) * MISSED


@pytest.mark.parametrize("share", [1.0, 0.4, 0.0])
def test_what_a_model_has_missed_grows_by_a_share_of_the_way(share: float) -> None:
    seen = grown(WAY, share)
    seen[1, 4] = np.nan  # a point that isn't seen
    skill = prediction_skill(WAY[:, None, None] * SHAPE, seen, WAY)
    assert skill == pytest.approx(1) if share in (0.0, 1.0) else 0.5 < skill < 1


def test_the_model_of_the_motion_predicts_better() -> None:
    right, wrong = WAY[:, None, None] * SHAPE, WAY[:, None, None] ** 2 * SHAPE[::-1]
    assert prediction_skill(right, grown(WAY), WAY) > prediction_skill(wrong, grown(WAY), WAY) + 0.1


def test_of_one_frame_there_is_no_skill() -> None:
    assert np.isnan(prediction_skill(np.zeros((1, 40, 2)), np.zeros((1, 40, 2)), np.zeros(1)))


def test_nearby_are_the_nearest_third_of_the_points_that_are_seen() -> None:
    """The nearest 35 of 100 seen points, those at the grip counted."""
    distance, moved = np.arange(120.0)[::-1], np.ones((120, 2))
    moved[distance >= 100] = np.nan
    nearby = Lattice(np.zeros((120, 2)), 8, distance).nearby(GripFrame(moved, distance < 10))
    np.testing.assert_array_equal(nearby.around, (distance >= 10) & (distance < 35))
    np.testing.assert_array_equal(nearby.gripped, distance < 10)


def test_of_a_long_run_as_many_frames_as_of_a_short_one_say_how_well_models_predict() -> None:
    assert telling(3).tolist() == [0, 1, 2]
    long = telling(50)
    assert (len(long), long[0], long[-1]) == (MOST_FRAMES, 0, 49)
