"""A sheet whose grip is not visible well: foundation and force are found again all the same, or it is said why not."""

import math

import numpy as np
import pytest

from palpate.estimators.grip import sheet
from palpate.estimators.grip.lattice import continued, lattice_springs
from palpate.estimators.model_errors import MODEL_ERRORS
from palpate.physics.sheet import equilibrium, response

SPACING, NOISE = 8, 0.1
ANCHOR = 0.05
PULLS = np.linspace(10.0, 40.0, 4)


PLACES = SPACING * np.stack(np.meshgrid(np.arange(1.0, 61), np.arange(1.0, 41)), axis=-1).reshape(-1, 2)
"""Of a grid [px]."""
DISTANCE = np.linalg.norm(np.maximum(np.abs(PLACES - [240, 80]) - [12, 80], 0), axis=1)
"""Theirs from a tool that comes from above."""
HIDDEN = DISTANCE <= 5
POINTS, AWAY = PLACES[~HIDDEN], DISTANCE[~HIDDEN]
GRID = sheet.PointGrid(POINTS, AWAY, PLACES[HIDDEN], SPACING)


def seen(dragged: float = 0.0, seed: int = 0, background: float = 0.0, anchor: float = ANCHOR) -> list[sheet.SeenFrame]:
    """Two nodes at the tool's tip are pulled; points within 12 px of the tool are off, as told."""
    answer, generator = response(anchor, sheet.SIZE), np.random.default_rng(seed)
    frames = []
    for pull in PULLS:
        moved = np.zeros_like(POINTS)
        for node in ((30, 20), (31, 20)):
            apart = np.rint(POINTS / SPACING).astype(int) - node
            moved += np.outer(answer[tuple(apart.T)] / answer[0, 0], [0.3 * pull, 0.5 * pull])
        moved += background * pull * (POINTS / 400 - 0.5)
        near = (AWAY < 12)[:, None]
        moved += NOISE * generator.normal(size=moved.shape) + np.where(near, [0.0, dragged * pull], 0.0)
        frames.append(sheet.SeenFrame(moved, np.where(near[:, 0] & (dragged > 0), dragged * pull, NOISE)))
    return frames


def fitted(frames: list[sheet.SeenFrame], measure=None) -> sheet.FoundationFit:
    """The fit, to points that are measured again, if told how."""
    again = () if measure is None else (sheet.Measuring(PLACES.reshape(40, 60, 2), measure),)
    return sheet.fit_foundation(GRID, frames, *again)


def true_log_force() -> float:
    """Of both nodes, by axis 0.3 and 0.5 of the pull over what a node gives way."""
    return math.log(2 * math.hypot(0.3, 0.5) * PULLS[-1] / response(ANCHOR, sheet.SIZE)[0, 0])


@pytest.mark.parametrize(("dragged", "background"), [(0.0, 0.0), (0.3, 0.0), (0.3, 0.3)])
def test_a_grip_whose_points_err_does_not_bias_what_is_told(dragged: float, background: float) -> None:
    found = fitted(seen(dragged, background=background))
    off = found.log_anchor - math.log(ANCHOR), found.log_force - true_log_force()
    assert np.abs(off).max() < 0.1
    assert abs(off[0]) < 2 * found.log_anchor_sd < 0.3
    assert abs(off[1]) < 2 * found.log_force_sd < 0.5
    np.testing.assert_allclose(found.force, PULLS / PULLS[-1], atol=0.05)
    assert (found.force[-1], found.force_sd[-1]) == pytest.approx((1.0, 0.0))


def test_points_measured_again_where_the_sheet_says_they_are_undo_a_bias() -> None:
    """Followed points go too little where they move most, as filtered ones do; measured again they don't."""
    exact, asked, near = seen(), [], (AWAY < 60)[:, None]
    biased = [sheet.SeenFrame(frame.moved * np.where(near, 0.97, 1.0), frame.noise) for frame in exact]

    def measure(number: int, motion: np.ndarray, which: np.ndarray) -> sheet.SeenFrame:
        assert {*np.flatnonzero(AWAY < sheet.DENSE)} < {*which}
        asked.append((number, motion.reshape(-1, 2)[~HIDDEN]))
        return exact[number]

    without, found = fitted(biased), fitted(biased, measure)
    assert abs(found.log_anchor - math.log(ANCHOR)) < 0.01 < abs(without.log_anchor - math.log(ANCHOR))
    assert [number for number, _ in asked] == sheet.LOOKS * [0, 1, 2, 3]
    for number, motion in asked[-4:]:
        assert np.median(np.linalg.norm(motion - exact[number].moved, axis=1)) < 2 * NOISE


@pytest.mark.parametrize("lost", [1, 3])
def test_frames_that_show_too_few_points_are_left_out_and_most_leave_points_as_followed(lost: int) -> None:
    """Four frames, of which one or three can't be measured again."""
    exact, asked = seen(), []

    def measure(number: int, motion: np.ndarray, which: np.ndarray) -> sheet.SeenFrame:
        asked.append(number)
        gone = np.full_like(exact[number].moved, np.nan)
        return sheet.SeenFrame(gone, exact[number].noise) if number < lost else exact[number]

    plain, found = fitted(exact), fitted(exact, measure)
    assert abs(found.log_anchor - math.log(ANCHOR)) < 0.01
    if lost == 1:
        assert asked == [0, 1, 2, 3, *(sheet.LOOKS - 1) * [1, 2, 3]]
        assert found.log_anchor_sd < plain.log_anchor_sd
    else:
        assert asked == [0, 1, 2, 3]
        assert found.log_anchor_sd == plain.log_anchor_sd >= MODEL_ERRORS.foundation_followed


def test_frames_that_share_no_point_are_taken_to_err_alike() -> None:
    left = np.full((2, 6, 2), np.nan)
    left[0, :3], left[1, 3:] = 1.0, -1.0
    np.testing.assert_array_equal(sheet.frame_correlation(left), 1.0)


def test_motion_that_is_no_sheets_is_refused() -> None:
    waves = PULLS[:, None, None] / 20 * np.sin(POINTS / 30)
    frames = [sheet.SeenFrame(frame.moved + wave, frame.noise) for frame, wave in zip(seen(), waves, strict=True)]
    with pytest.raises(sheet.NoSheet, match="px off besides their noise"):
        fitted(frames)


def test_a_tool_that_hides_too_much_is_refused() -> None:
    hidden = DISTANCE <= 140
    points = PLACES[~hidden]
    frames = [sheet.SeenFrame(np.ones_like(points), np.full(len(points), NOISE))]
    with pytest.raises(sheet.NoSheet, match=r"from 1 to 400"):
        sheet.fit_foundation(sheet.PointGrid(points, DISTANCE[~hidden] - 140, PLACES[hidden], SPACING), frames)


def test_what_is_left_and_goes_together_over_many_points_widens_what_is_told() -> None:
    """A wave within a given noise that is three times too large."""
    waves, frames = (0.0, 0.15 * np.sin(POINTS / 25)), seen()
    plain, waved = (fitted([sheet.SeenFrame(one.moved + wave, 3 * one.noise) for one in frames]) for wave in waves)
    # Less the prior's share.
    assert plain.log_anchor_sd < 0.1 < 0.98 * MODEL_ERRORS.foundation_uneven < waved.log_anchor_sd
    assert plain.log_force_sd < MODEL_ERRORS.force_uneven <= waved.log_force_sd


@pytest.mark.parametrize("measured", [False, True])
def test_motion_that_spreads_farther_by_larger_pulls_refutes_one_sheet(measured: bool) -> None:
    """The foundation under the two larger pulls is 40 % looser, as far as springs are concerned; or it is firmer."""

    def fit(frames: list[sheet.SeenFrame]) -> sheet.FoundationFit:
        return fitted(frames, (lambda number, *_: frames[number]) if measured else None)

    tight, loose = seen(), seen(anchor=0.6 * ANCHOR)
    wider, narrower = fit([*tight[:2], *loose[2:]]), fit([*loose[:2], *tight[2:]])
    assert narrower.widens < -sheet.WIDENS < sheet.WIDENS < wider.widens
    # Less the prior's share.
    assert narrower.log_anchor_sd < 0.1 < 0.98 * MODEL_ERRORS.foundation_uneven < wider.log_anchor_sd
    assert abs(fit(tight).widens) < 2
    assert fit([tight[0], tight[0]]).widens == 0


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_pulls_that_tell_little_are_not_compared(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.estimators.grip.test_sheet.PULLS", np.array([0.4, 0.8, 3.0, 3.4]))
    frames = seen(seed=seed)
    assert fitted(frames).widens == 0
    monkeypatch.setattr(sheet, "VAGUE", np.inf)
    assert fitted(frames).widens != 0


def test_frames_that_err_alike_tell_what_one_does() -> None:
    curvatures = np.full(4, 25.0)
    assert sheet.information(curvatures, np.eye(4)) == pytest.approx(100)
    assert sheet.information(curvatures, np.ones((4, 4))) == pytest.approx(25)
    assert sheet.information(np.array([0.0, -3.0]), np.eye(2)) == 0


def test_correlation_of_errors_is_measured() -> None:
    generator = np.random.default_rng(0)
    one, other = generator.normal(size=(2, 5000, 2))
    errors = 0.5 * np.stack([one, 0.6 * one + 0.8 * other])
    errors[0, :50] = np.nan
    np.testing.assert_allclose(sheet.frame_correlation(errors), [[1, 0.6], [0.6, 1]], atol=0.03)


def stiffened(b: float) -> list[sheet.SeenFrame]:
    """Four nodes at the tool's tip are pulled on a lattice that ends; springs are exp(b·strain²/2) times as stiff."""
    nodes = continued(PLACES, SPACING, 20)
    springs = lattice_springs(nodes, SPACING)
    number = {tuple(cell): index for index, cell in enumerate(np.rint(nodes / SPACING).astype(int))}
    held = np.isin(np.arange(len(nodes)), [number[30 + i, 19 + j] for i in (0, 1) for j in (0, 1)])
    shown = [number[tuple(cell)] for cell in np.rint(POINTS / SPACING).astype(int)]
    length = np.linalg.norm(nodes[springs[:, 0]] - nodes[springs[:, 1]], axis=1)
    generator, stiffness, frames = np.random.default_rng(0), np.ones(len(springs)), []
    for pull in PULLS:
        for _ in range(60):
            motion = np.tile([0.51 * pull, 0.85 * pull], (4, 1))
            found = equilibrium(springs, stiffness, np.full(len(nodes), ANCHOR), held, motion).displacement
            strain = np.linalg.norm(found[springs[:, 0]] - found[springs[:, 1]], axis=1) / length
            stiffness = np.sqrt(stiffness * np.exp(b * strain**2 / 2))
        moved = found[shown] + NOISE * generator.normal(size=(len(shown), 2))
        frames.append(sheet.SeenFrame(moved, np.full(len(shown), NOISE)))
    return frames


@pytest.mark.slow
def test_tissue_that_stiffens_is_explained_by_no_sheet() -> None:
    linear = fitted(stiffened(0.0))
    assert linear.log_anchor == pytest.approx(math.log(ANCHOR), abs=0.05)
    assert abs(linear.widens) < 1
    with pytest.raises(sheet.NoSheet, match="off besides their noise"):
        fitted(stiffened(5.0))
