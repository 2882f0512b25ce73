"""The record of a frame."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.stats import norm

from estimators.estimate import NINETY, ContactEstimate, FrameEstimate, uncertainty


def test_everything_unknown_is_none() -> None:
    estimate = FrameEstimate(3, 0.12, "no_tool")
    values = dataclasses.asdict(estimate)
    assert {name for name, value in values.items() if value is not None} == {
        "frame",
        "time_s",
        "status",
        "detail",
        "verdict",
    }


def test_ninety_is_the_normal_distributions() -> None:
    assert norm.cdf(NINETY) - norm.cdf(-NINETY) == pytest.approx(0.9, abs=1e-15)


def test_uncertainty_is_the_log_normal_distributions() -> None:
    found = ContactEstimate(
        theta=np.array([0.5, 0.06, -0.1]),
        covariance=np.diag([0.04, 0.25, 1.0]),
        information=np.diag([100.0, 25.0, 4.0]),
        noise=0.001,
        misfit=1.0,
        at_bound=np.zeros(3, bool),
    )
    fields = uncertainty(found)
    # sd = median·exp(s²/2)·sqrt(exp(s²) - 1); for s = 1: 0.1·1.6487·1.3108.
    assert fields["force_sd"] == pytest.approx(0.1 * 1.6487212707 * 1.3108324957)
    assert fields["stiffness_sd"] == pytest.approx(0.5 * 1.0202013400 * np.sqrt(np.expm1(0.04)))
    assert (fields["damping_low"], fields["damping_high"]) == pytest.approx(
        (0.06 * 0.4393641, 0.06 * 2.2760167), rel=1e-6
    )
    assert [fields[f"{name}_bound"] for name in ("stiffness", "damping", "force")] == pytest.approx([0.1, 0.2, 0.5])
