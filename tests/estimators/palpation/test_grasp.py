"""The slope of a grasp whose width is read seldom."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.estimators.palpation import fit_grasp
from palpate.estimators.palpation.curves import Grasp


def test_the_slope_of_a_spring_whose_width_is_read_every_other_frame() -> None:
    force = np.linspace(0, 12, 61)
    width = 60 - force / 2.5
    repeated = width[(np.arange(61) // 2) * 2]
    assert fit_grasp(Grasp(force, width)).stiffness == pytest.approx(2.5)
    assert fit_grasp(Grasp(force, repeated)).stiffness == pytest.approx(2.5)


def test_opening_does_not_count() -> None:
    force = np.concatenate([np.linspace(0, 12, 25), np.linspace(12, 0, 25)])
    width = np.concatenate([60 - np.linspace(0, 12, 25) / 2, np.linspace(54, 70, 25)])
    assert fit_grasp(Grasp(force, width)).stiffness == pytest.approx(2.0)


def test_a_width_that_never_changes_is_infinitely_stiff() -> None:
    assert fit_grasp(Grasp(np.linspace(0, 10, 20), np.full(20, 40.0))).stiffness == np.inf


def test_a_jump_over_the_range_is_said() -> None:
    with pytest.raises(ValueError, match="only 0 frames"):
        fit_grasp(Grasp(np.array([0.0, 1, 9, 10]), np.array([60.0, 59, 50, 49])))
