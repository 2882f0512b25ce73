"""E and ν come back from a press whose truth is known, and the covariance says how well."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from estimators.palpation import FitSettings, Palpation, Skin, fit_material
from estimators.palpation.material_fit import descend
from evaluation.palpation.synthetic import BODIES, observe, press

BODY = dataclasses.replace(BODIES["slab"], size=0.08)


@pytest.fixture(scope="module")
def slab() -> tuple[Skin, np.ndarray, Palpation]:
    """A press by the fit's own mesh and law: what is left is the noise."""
    skin, held = BODY.skin(4, BODY.size / 20)
    truth = press(BODY, 1e4, 0.42, 1.0, (0.1, 0.5), 4, law="corotational")
    return skin, held, observe(*truth, "stereo", 3, count=800)


@pytest.mark.parametrize("start", [30.0, 1 / 30])
def test_starts_far_off_arrive(slab: tuple[Skin, np.ndarray, Palpation], start: float) -> None:
    skin, held, seen = slab
    found = fit_material(skin, held, [seen], FitSettings(young=1e4 * start, model_error=0.0))
    assert abs(np.log(found.young / 1e4)) < 3 * found.young_sd
    assert abs(found.poisson - 0.42) < 3 * found.poisson_sd
    assert found.young_sd < 0.15
    assert found.noise < 0.0004
    assert found.solves < 25


def test_errors_of_the_model_widen_the_intervals(slab: tuple[Skin, np.ndarray, Palpation]) -> None:
    skin, held, seen = slab
    sds = [fit_material(skin, held, [seen], FitSettings(model_error=error)).young_sd for error in (0.0, 0.1)]
    assert sds[1] > 1.2 * sds[0]


@pytest.mark.slow
def test_the_paper_s_descent_goes_the_same_way_with_more_solves(slab: tuple[Skin, np.ndarray, Palpation]) -> None:
    skin, held, seen = slab
    exact = fit_material(skin, held, [seen], FitSettings(young=2e4))
    numeric = descend(skin, held, [seen], FitSettings(young=2e4), most=120)
    assert abs(numeric.young / exact.young - 1) < 0.25
    assert numeric.solves > 2 * exact.solves
    assert np.isnan(numeric.covariance).all()
