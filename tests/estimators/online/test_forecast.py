"""Motion to come: a sheet of one number, what models have missed carried on, and the choice between them."""

import numpy as np
import pytest

from palpate.estimators.grip.lattice import GripFrame, NothingMoves
from palpate.estimators.online.forecast import FIELD, MOST_FRAMES, RATIOS, SHEET, Lattice, forecast, telling

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
    with pytest.raises(NothingMoves, match="In none of 1 frames"):
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
def test_what_a_model_has_missed_grows_by_the_share_that_frames_so_far_say(share: float) -> None:
    """The first frame's way is 1: of later ones the missed part is MISSED and a share of its growth since."""
    seen, later = grown(WAY[:3], share), grown(WAY[3:], share)
    seen[1, 4] = np.nan  # a point that isn't seen
    found = forecast({FIELD: WAY[:, None, None] * SHAPE}, seen, WAY)
    if share in (0.0, 1.0):
        np.testing.assert_allclose(found.since, later - seen[-1], atol=1e-9)
        assert found.skills[FIELD] == pytest.approx(1)
    else:
        off = np.linalg.norm(found.since[-1] - (later - seen[-1])[-1])
        assert off < 0.5 * np.linalg.norm(WAY[-1] * SHAPE - WAY[2] * SHAPE - (later - seen[-1])[-1])


def test_the_model_that_predicts_better_is_used() -> None:
    seen = grown(WAY[:3])
    right, wrong = WAY[:, None, None] * SHAPE, WAY[:, None, None] ** 2 * SHAPE[::-1]
    for models, best in (({FIELD: right, SHEET: wrong}, FIELD), ({FIELD: wrong, SHEET: right}, SHEET)):
        found = forecast(models, seen, WAY)
        assert found.model == best
        assert found.skills[best] > max(value for name, value in found.skills.items() if name != best) + 0.1
        np.testing.assert_allclose(found.since, grown(WAY[3:]) - seen[-1], atol=1e-9)


def test_nothing_to_come_and_nothing_to_judge_by() -> None:
    assert forecast({FIELD: WAY[:3, None, None] * SHAPE}, grown(WAY[:3]), WAY[:3]).since.shape == (0, 40, 2)
    still = forecast({FIELD: np.zeros((2, 40, 2))}, np.zeros((1, 40, 2)), np.zeros(2))
    assert np.isnan(still.skills[FIELD])
    np.testing.assert_array_equal(still.since, 0)


def test_of_a_long_run_as_many_frames_as_of_a_short_one_say_how_well_models_predict() -> None:
    assert telling(3).tolist() == [0, 1, 2]
    long = telling(50)
    assert (len(long), long[0], long[-1]) == (MOST_FRAMES, 0, 49)
