"""Forces found again from points of the surface."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from palpate.evaluation.foreign.liver import judge_pull, read_pull
from palpate.evaluation.foreign.surface_fit import SurfaceFit, fit_surface
from tests.evaluation.foreign.pulls import FORCES, write_pull


@pytest.mark.parametrize("law", list(FORCES))
def test_the_force_is_found_from_rest(law: str, tmp_path: Path) -> None:
    pull = read_pull(write_pull(tmp_path, law))
    fit = fit_surface(pull.body, pull.material, pull.held, pull.motion[0], pull.pulled, pull.points[0])
    np.testing.assert_allclose(fit.force, pull.force[0], rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(fit.nodal.sum(axis=0), fit.force)
    assert fit.along(pull.force[0])[0] == pytest.approx(np.linalg.norm(pull.force[0]), rel=1e-4)


@pytest.mark.slow
def test_intervals_hold_under_noise(tmp_path: Path) -> None:
    """Of 30 draws of a millimetre's noise, 90 % intervals of the force's size hold about as many as they say."""
    pull = read_pull(write_pull(tmp_path, "linear"))
    arguments = pull.body, pull.material, pull.held, pull.motion[0], pull.pulled
    fit, scores = fit_surface(*arguments, pull.points[0]), []
    for seed in range(30):
        noise = 1e-3 * np.random.default_rng(seed).normal(size=pull.points[0].shape)
        again = fit_surface(*arguments, pull.points[0] + noise, fit)
        size, spread = again.magnitude
        scores.append((size - np.linalg.norm(pull.force[0])) / spread)
        assert again.noise == pytest.approx(1e-3, rel=0.2)
    assert 0.7 < np.std(scores) < 1.4
    assert np.mean(np.abs(scores) < 1.645) >= 0.8


@pytest.mark.parametrize("law", list(FORCES))
def test_frames_without_force_are_counted_and_left_out(law: str, tmp_path: Path) -> None:
    """At the beginning and between others: neither a fit nor an error is relative to nothing."""
    rest, (one, two) = np.zeros(3), FORCES[law]
    found = judge_pull(write_pull(tmp_path, law, pulls=np.array([rest, one, rest, two])))
    assert (found["frames"], found["frames without force"], found["frames without a fit"]) == (2, 2, 0)
    assert 0 <= found["force found in frames without, largest (N)"] < 1e-4
    assert found["force error, largest"] < 1e-3
    assert abs(found["E error, median"]) < 1e-3
    assert found["force: share of frames in the 90 % interval"] == 1


def test_a_force_of_no_size_has_a_standard_deviation_and_a_direction_of_no_length_is_refused() -> None:
    covariance = np.diag([1.0, 4.0, 9.0])
    fit = SurfaceFit(None, None, np.zeros(3), covariance, 0.0, None)
    assert fit.magnitude == (0.0, pytest.approx(3.0))
    with pytest.raises(ValueError, match="a direction of no length is none; leave out frames without a force"):
        fit.along(np.zeros(3))


def test_a_sequence_is_judged(tmp_path: Path) -> None:
    found = judge_pull(write_pull(tmp_path, "linear"))
    assert found["law"] == "linear"
    assert (found["frames"], found["frames without force"]) == (2, 0)
    assert found["force error, median where above 1 N"] < 1e-4
    assert abs(found["E error, median"]) < 1e-4
    assert found["E (Pa), median"] == pytest.approx(20e3, rel=1e-4)
    assert found["noise found (m), median with 0.6 mm of noise added"] == pytest.approx(6e-4, rel=0.25)
    assert found["force error, median where above 1 N with 0.6 mm of noise added"] < 0.1
