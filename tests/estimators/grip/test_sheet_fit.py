"""Sheets that are fitted to frames made by the simulator: what is found again, how sure it is, and what is refused."""

import numpy as np
import pytest

from palpate.estimators.grip import lattice
from palpate.physics.sheet import equilibrium

SPACING, COLUMNS, ROWS = 8, 20, 16
NOISE = 0.02
"""Of synthetic frames [px]."""


def grid(columns: int = COLUMNS, rows: int = ROWS) -> np.ndarray:
    row, column = np.mgrid[:rows, :columns]
    return SPACING * np.column_stack([column.ravel() + 1, row.ravel() + 1]).astype(np.float64)


def held(points: np.ndarray) -> np.ndarray:
    """24 nodes around the middle of the left edge."""
    return (points[:, 0] <= 4 * SPACING) & (np.abs(points[:, 1] - 8.5 * SPACING) < 3 * SPACING)


NODES = lattice.continued(grid(), SPACING, lattice.BEYOND)
"""Of a sheet of one number: the points, and the tissue beyond them."""
SPRINGS = lattice.lattice_springs(NODES, SPACING)


def pulled(anchor: float, gripped: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Displacement of the points when some are held, by springs of stiffness 1 and a foundation."""
    everywhere = np.append(gripped, np.zeros(len(NODES) - len(gripped), bool))
    alike = np.ones(len(SPRINGS)), np.full(len(NODES), anchor)
    return equilibrium(SPRINGS, *alike, everywhere, motion).displacement[: len(gripped)]


def even(log_anchor: float, pulls: np.ndarray, noise: float = NOISE, seed: int = 0) -> list[lattice.GripFrame]:
    """A grip that pulls and turns a little, every point's motion off by noise, on tissue that is alike everywhere."""
    points = grid()
    gripped = held(points)
    off = points[gripped] - points[gripped].mean(axis=0)
    generator, frames = np.random.default_rng(seed), []
    for pull in pulls:
        motion = pull * (np.array([1.0, 0.4]) + 0.01 * off @ np.array([[0, 1], [-1, 0]]))
        found = pulled(np.exp(log_anchor), gripped, motion)
        frames.append(lattice.GripFrame(found + generator.normal(0, noise, found.shape), gripped))
    return frames


def test_roots_of_mean_squares() -> None:
    assert lattice.length(np.array([[3.0, 4.0], [0.0, 0.0]])) == pytest.approx(np.sqrt(12.5))


def test_a_frame_tells_what_is_seen_and_moves() -> None:
    count = lattice.LEAST_GRIPPED + lattice.LEAST_AROUND
    moved = np.broadcast_to([3.0, 4.0], (count, 2)).copy()
    gripped = np.arange(count) < lattice.LEAST_GRIPPED
    frame = lattice.GripFrame(moved, gripped)
    assert (frame.pull, frame.tells) == (pytest.approx(5.0), True)
    np.testing.assert_array_equal(frame.around, ~gripped)
    assert not lattice.GripFrame(moved, gripped & (np.arange(count) > 0)).tells
    lost = moved.copy()
    lost[-1, 1] = np.nan
    assert not lattice.GripFrame(lost, gripped).tells
    np.testing.assert_array_equal(lattice.GripFrame(lost, gripped).around, ~gripped & (np.arange(count) < count - 1))
    still = np.where(gripped[:, None], moved, [0.6, 0.79])
    assert not lattice.GripFrame(still, gripped).tells  # 0.99 px
    assert lattice.GripFrame(np.where(gripped[:, None], moved, [0.6, 0.81]), gripped).tells


@pytest.mark.parametrize("anchor", [0.002, 0.02, 0.2])
def test_a_foundation_is_found_again(anchor: float) -> None:
    fit = lattice.fit_sheet(grid(), SPACING, even(np.log(anchor), np.linspace(12, 24, 6)))
    assert fit.log_anchor == pytest.approx(np.log(anchor), abs=0.05)
    assert abs(fit.log_anchor - np.log(anchor)) < 3 * fit.log_anchor_sd


def test_a_disc_of_the_radius_holds_ninety_per_cent() -> None:
    draws = np.random.default_rng(0).normal(size=(200_000, 2))
    assert (np.linalg.norm(draws, axis=1) < lattice.RADIUS).mean() == pytest.approx(0.9, abs=0.003)


def test_forces_are_over_that_of_the_last_frame() -> None:
    frames = even(np.log(0.05), np.linspace(6, 24, 7))
    fit = lattice.fit_sheet(grid(), SPACING, frames)
    force, sd = fit.relative_force(frames)
    np.testing.assert_allclose(force, np.linspace(6, 24, 7) / 24, rtol=0.01)
    assert force[-1] == pytest.approx(1)
    assert sd[-1] == pytest.approx(0)
    # For as long as the same tissue is held, all forces change alike with the foundation.
    assert sd.max() < 1e-3


def test_points_that_the_grip_loses_do_not_change_its_force() -> None:
    """Only what is observed in all frames is held; where that is too little, nothing is said."""
    whole = held(grid())
    fewer = whole & (np.cumsum(whole) <= 21)

    def frame(gripped: np.ndarray, pull: float) -> lattice.GripFrame:
        return lattice.GripFrame(pulled(0.05, whole, np.full((whole.sum(), 2), pull)), gripped)

    fit = lattice.SheetFit(len(whole), len(NODES), SPRINGS, None, float(np.log(0.05)), 0.3, 0.1)
    frames = [frame(whole, 5.0), frame(fewer, 10.0), frame(whole, 10.0)]
    force, sd = fit.relative_force(frames)
    np.testing.assert_allclose(force, [0.5, 1, 1], rtol=1e-6)
    np.testing.assert_allclose(sd, [0.1 * 0.25, 0, 0], atol=1e-6)
    unknown = fit.relative_force([*frames, frame(whole & (np.cumsum(whole) <= 15), 10.0)])
    assert np.isnan(unknown).all()


def test_a_force_across_the_last_one_is_uncertain() -> None:
    gripped = held(grid())
    ways = [np.tile(pull, (gripped.sum(), 1)) for pull in ([6.0, 0.0], [0.0, 12.0])]
    frames = [lattice.GripFrame(pulled(0.05, gripped, way), gripped) for way in ways]
    fit = lattice.SheetFit(len(gripped), len(NODES), SPRINGS, None, float(np.log(0.05)), 0.0, 0.1)
    force, sd = fit.relative_force(frames)
    np.testing.assert_allclose(force, [0, 1], atol=1e-9)
    np.testing.assert_allclose(sd, [0.1 * 0.5, 0], atol=1e-6)


def test_lost_points_do_not_count() -> None:
    frames = even(np.log(0.02), np.linspace(12, 24, 6))
    generator = np.random.default_rng(2)
    for frame in frames:
        frame.moved[(generator.random(len(frame.moved)) < 0.3) & ~frame.gripped] = np.nan
    fit = lattice.fit_sheet(grid(), SPACING, frames)
    assert fit.log_anchor == pytest.approx(np.log(0.02), abs=0.05)
    assert np.isfinite(fit.held(frames[-1]).found.displacement).all()
    assert 0 < fit.error < 0.2


def test_frames_without_motion_do_not_count() -> None:
    pulls = np.linspace(12, 24, 6)
    moving = even(np.log(0.02), pulls)
    still = lattice.GripFrame(np.full_like(moving[0].moved, 0.01), moving[0].gripped)
    one = lattice.fit_sheet(grid(), SPACING, moving)
    other = lattice.fit_sheet(grid(), SPACING, [still, *moving[:3], still, *moving[3:]])
    assert (one.log_anchor, one.error) == (other.log_anchor, other.error)


def test_the_likeliest_numbers_have_no_slope() -> None:
    """Where the optimiser stops no other number is likelier, and the density's curvature is 1 / variance."""
    frames = even(np.log(0.02), np.array([12.0, 24.0]), noise=0.3)
    sheet = lattice.SheetFit(len(grid()), len(NODES), SPRINGS, None)

    def loss(number: float) -> float:
        value = 0.5 * ((number - np.log(lattice.TYPICAL_ANCHOR)) / lattice.SPREAD) ** 2
        for frame in frames:
            found = sheet.at(number).held(frame).found.displacement[: len(frame.moved)]
            error = (found - frame.moved)[frame.around]
            value += len(error) / lattice.PIECE**2 / len(frames) * np.log(np.square(error).sum())
        return float(value)

    found = lattice._likeliest(sheet.at(np.log(0.02) + 0.5), frames)
    best = min(np.linspace(np.log(0.02) - 0.5, np.log(0.02) + 0.5, 401).tolist(), key=loss)
    assert found.log_anchor == pytest.approx(best, abs=0.005)
    step, here = 0.02, found.log_anchor
    curvature = (loss(here + step) - 2 * loss(here) + loss(here - step)) / step**2
    assert lattice._deviation(found, frames) ** -2 == pytest.approx(curvature, rel=0.05)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 6, 9, 30])
def test_fitted_frames_are_few_evenly_spread_and_end_with_the_last(count: int) -> None:
    used = lattice.evenly(count, lattice.MOST_FRAMES)
    assert used[-1] == count - 1
    assert min(count, 2) <= len(used) <= lattice.MOST_FRAMES
    assert len(used) <= 2 or np.ptp(np.diff(used)) <= 1
    assert len(used) == lattice.MOST_FRAMES or count <= lattice.MOST_FRAMES


@pytest.mark.parametrize(
    ("pulls", "gripped", "telling"), [((12, 24, 0.1, 0.1), 100, 2), ((12, 18, 24), lattice.LEAST_GRIPPED - 1, 0)]
)
def test_too_few_frames_that_move_or_show_the_instrument_are_a_sentence(pulls, gripped: int, telling: int) -> None:
    frames = [
        lattice.GripFrame(frame.moved, frame.gripped & (np.cumsum(frame.gripped) <= gripped))
        for frame in even(np.log(0.02), np.array(pulls))
    ]
    told = f"In {telling} of {len(pulls)} frames the tissue moves by more than 1 px, with 20 points seen at the"
    with pytest.raises(lattice.NothingMoves, match=f"{told} instrument and 50 around it; 3 are needed"):
        lattice.fit_sheet(grid(), SPACING, frames)


def test_a_background_that_moves_affinely_is_told_from_the_sheet() -> None:
    points = grid()
    still = even(np.log(0.05), np.linspace(6, 24, 7))
    terms = np.column_stack([points / 100, np.ones(len(points))])
    ways = terms @ np.random.default_rng(4).normal(0, 5, (len(still), 3, 2))
    carried = [lattice.GripFrame(frame.moved + way, frame.gripped) for frame, way in zip(still, ways, strict=True)]
    plain = lattice.fit_sheet(points, SPACING, still, background=True)
    fit = lattice.fit_sheet(points, SPACING, carried, background=True)
    # However the background moves, what is left is the same.
    assert (fit.log_anchor, fit.log_anchor_sd) == pytest.approx((plain.log_anchor, plain.log_anchor_sd), rel=1e-4)
    assert fit.log_anchor == pytest.approx(np.log(0.05), abs=0.1)
    assert lattice.skill(fit, carried[-1]) == pytest.approx(lattice.skill(plain, still[-1]), abs=1e-4)
    assert fit.log_force(carried[-1]) == pytest.approx(plain.log_force(still[-1]), abs=1e-3)
    # Not to know whether it moves costs something.
    alone = lattice.fit_sheet(points, SPACING, still)
    assert plain.log_anchor_sd > alone.log_anchor_sd
    assert lattice.fit_sheet(points, SPACING, carried).log_anchor != pytest.approx(np.log(0.05), abs=0.3)


def test_shares_of_errors_are_found_again() -> None:
    generator = np.random.default_rng(6)
    pull, motion = np.repeat([100.0, 400.0], 20_000), generator.uniform(0, 300, 40_000)
    variance = 0.02**2 * pull + 0.1**2 * motion
    error = np.square(np.sqrt(variance)[:, None] * generator.normal(size=(40_000, 2))).sum(axis=1)
    assert lattice.error_shares(error, motion, pull) == pytest.approx((0.02, 0.1), rel=0.05)


def test_the_force_is_what_the_foundation_holds() -> None:
    frames = even(np.log(0.05), np.linspace(6, 24, 7), noise=0.0)
    fit = lattice.fit_sheet(grid(), SPACING, frames)
    log, sd = fit.log_force(frames[-1])
    found = fit.held(frames[-1]).found
    total = np.exp(fit.log_anchor) * found.displacement.sum(axis=0)
    assert np.exp(log) == pytest.approx(np.linalg.norm(total), rel=1e-6)
    assert 0 < sd < 0.3
