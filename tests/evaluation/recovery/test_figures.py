"""Figures of the benchmark: what is drawn, not how it looks."""

import numpy as np
import pytest

from palpate.evaluation.recovery.figures import draw_recovery, figures
from palpate.evaluation.recovery.scores import score_all
from tests.evaluation.recovery_cases import BY_CONTACT, TRUTH, off_by, recovery


@pytest.fixture(scope="module")
def scores():
    generator = np.random.default_rng(0)
    rows = [recovery(index, estimate=off_by(generator.normal(0, 0.1, 3))) for index in range(600)]
    rows += [recovery(0, suite="noisy", covariance=None)]
    return score_all(rows, BY_CONTACT)


def test_every_panel_names_its_axes_and_unit(scores):
    for axes in draw_recovery(scores[0]).axes:
        assert axes.get_xlabel().startswith("true")
        assert axes.get_ylabel().endswith("[scene units]")


def test_the_best_constant_is_that_of_the_identifiable_clips():
    vague = np.diag((0.001 / np.array([0.1, 0.6, 0.1])) ** 2)
    rows = [recovery(index, theta=off_by([0, shift, 0])) for index, shift in enumerate((0.0, 0.4))]
    rows.append(recovery(2, theta=off_by([0, 3.0, 0]), information=vague))
    (scores,) = score_all(rows, BY_CONTACT)
    heights = []
    for axes in draw_recovery(scores).axes:
        (line,) = [line for line in axes.lines if line.get_label() == "best constant"]
        heights.append(line.get_ydata()[0])
    assert heights == pytest.approx([TRUTH[0], TRUTH[1] * np.exp(0.2), -TRUTH[2]])
    (blind,) = score_all([recovery(0, information=1e-9 * np.eye(3))], BY_CONTACT)
    labels = {line.get_label() for axes in draw_recovery(blind).axes for line in axes.lines}
    assert "best constant" not in labels


def test_files_of_every_estimator_and_suite(scores):
    assert [name for name, _ in figures(scores)] == ["recovery_direct_clean.png", "recovery_direct_noisy.png"]
