"""Figures of the benchmark: what is drawn, not how it looks."""

import numpy as np
import pytest

from evaluation.benchmark_figures import LEVELS, coverage_curve, draw_recovery, figures, normal_width
from evaluation.recovery_scores import score_all
from tests.evaluation.recovery_cases import TRUTH, off_by, recovery


@pytest.fixture(scope="module")
def scores():
    generator = np.random.default_rng(0)
    rows = [recovery(index, estimate=off_by(generator.normal(0, 0.1, 3))) for index in range(600)]
    rows += [recovery(0, suite="noisy", covariance=None)]
    return score_all(rows, np.log(np.abs(TRUTH)))


def test_normal_widths():
    assert normal_width(0.9) == pytest.approx(1.6449, abs=1e-4)
    assert normal_width(0.6827) == pytest.approx(1.0, abs=1e-3)


def test_a_calibrated_estimate_lies_on_the_diagonal(scores):
    np.testing.assert_allclose(coverage_curve(scores[0], 0), LEVELS, atol=0.07)


def test_no_curve_without_standard_deviations(scores):
    assert coverage_curve(scores[1], 0) is None


def test_every_panel_names_its_axes_and_unit(scores):
    for axes in draw_recovery(scores[0]).axes:
        assert axes.get_xlabel().startswith("true")
        assert axes.get_ylabel().endswith("[scene units]")


def test_files_of_every_estimator_and_suite(scores):
    assert [name for name, _ in figures(scores)] == [
        "recovery_direct_clean.png",
        "errors_direct_clean.png",
        "recovery_direct_noisy.png",
        "errors_direct_noisy.png",
        "coverage_direct.png",
    ]
