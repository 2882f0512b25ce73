"""Firm regions beneath a dent: noticed, and averaged over."""

import math
from typing import Any

import numpy as np
import pytest

from palpate.estimators.direct import slab_fit
from palpate.estimators.direct.field import SequenceProblem
from palpate.estimators.direct.slab_fit import Firm, averaged, firm_regions, with_firm_regions
from palpate.estimators.direct.slab_motion import FirmRegion, SlabMotion
from palpate.physics.fem import NoEquilibrium
from tests.estimators.direct.slabs import FINE, LOGS, THICKNESS, TIMES, empty_problem, problem_of, shows
from tests.estimators.direct.test_field import MESH


@pytest.mark.slow
def test_a_firm_region_is_noticed_where_it_lies_and_taken_into_account() -> None:
    problem = empty_problem(FINE)
    moved = problem.motion.at(LOGS)[0]
    shows(problem, moved)
    problem.look(LOGS)
    regions = [region for region, _ in firm_regions(problem, LOGS, THICKNESS, 1.0)]
    assert len({tuple(region.centre) for region in regions}) == 2 * slab_fit.WAYS

    def with_regions(beginnings: list[tuple[FirmRegion, np.ndarray]], alike: np.ndarray) -> list[Firm]:
        def problem_with(region: FirmRegion) -> SequenceProblem[SlabMotion]:
            found = problem_of(problem.contact, problem.motion.slab, region=region)
            found.observed = problem.observed
            return found

        return with_firm_regions(problem, alike, beginnings, problem_with, 1.0)

    assert averaged(with_regions(firm_regions(problem, LOGS, THICKNESS, 1.0), LOGS))[0] < 0.5
    true = regions[0]
    firm = SlabMotion(problem.contact, problem.motion.slab, MESH.pixels[problem.patches.vertices], TIMES, region=true)
    shows(problem, firm.at(LOGS)[0], moved)
    problem.look(LOGS)
    alike = slab_fit.descend(problem, LOGS, problem.motion.box, 0.01)
    problem.look(alike)
    found = firm_regions(problem, alike, THICKNESS, 1.0)
    beside = np.linalg.norm(found[0][0].centre - true.centre)
    assert beside < true.radius  # how far aside it lies hardly shows
    sure, shift, covariance = averaged(with_regions(found, alike))
    assert sure > 0.9
    assert np.linalg.eigvalsh(covariance).min() > -1e-12
    # What it makes of the ratios goes, mostly.
    for ratio in ([-1.0, 1.0, 0.0], [-1.0, 0.0, 1.0]):
        before = float((alike - LOGS) @ ratio)
        assert abs(before + shift @ ratio) < 0.5 * abs(before)


def test_regions_that_cannot_be_followed_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, followed = empty_problem(), SlabMotion._followed
    shows(problem, problem.motion.at(LOGS)[0])
    problem.look(LOGS)

    def fails(self: SlabMotion, logs: np.ndarray, *told: Any) -> Any:
        if self.region is not None or self.relaxing:
            raise NoEquilibrium("no equilibrium.")
        return followed(self, logs, *told)

    def problem_with(region: FirmRegion | None, relaxing: bool = False) -> SequenceProblem[SlabMotion]:
        return problem_of(problem.contact, problem.motion.slab, relaxing=relaxing, region=region)

    regions = firm_regions(problem, LOGS, THICKNESS, 1.0)
    monkeypatch.setattr(SlabMotion, "_followed", fails)
    fits = with_firm_regions(problem, LOGS, regions, problem_with, 1.0)
    assert fits == []
    assert slab_fit.relaxation(problem, LOGS, problem_with(None, relaxing=True), fits, 1.0) == ""


def test_pixels_that_show_nothing_in_one_fit_count_in_neither() -> None:
    """Beside a hole another motion hides pixels that this one shows."""
    problem, other = empty_problem(), empty_problem()
    shows(problem, problem.motion.at(LOGS)[0])
    problem.look(LOGS)
    beside = LOGS + np.array([0.1, 0.0, 0.0])
    other.look(beside)
    whole = slab_fit.fall(problem, LOGS, other, beside)
    assert whole < -1  # it explains less
    hidden, change = problem.seen.shape[1] // 2, other.change

    def partly(moved: np.ndarray, logs: np.ndarray) -> np.ndarray:
        found = change(moved, logs)
        found[:, hidden] = np.nan
        return found

    other.change = partly  # ty: ignore[invalid-assignment]
    part = slab_fit.fall(problem, LOGS, other, beside)
    assert 2 * whole < part < -1


def test_posteriors_are_averaged_by_their_evidence() -> None:
    shift = np.array([-0.2, 0.1, 0.3])
    # A half beforehand for none, a quarter for each fit: 1/2 to 3/4.
    sure, mean, covariance = averaged([Firm(math.log(3.0), shift), Firm(-math.inf, 9 * shift)])
    assert sure == pytest.approx(0.6)
    np.testing.assert_allclose(mean, 0.6 * shift)
    np.testing.assert_allclose(covariance, 0.24 * np.outer(shift, shift))
    assert averaged([])[0] == 0.0
    np.testing.assert_array_equal(averaged([])[1], 0.0)
