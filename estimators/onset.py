"""When a press begins is known to a frame only: what that adds to an estimate's uncertainty.

Every simulated press begins at the time stamp of the first frame in contact. A real one begins up to a frame interval
before or after it, and an estimate that takes the stamp for the beginning is surer than it may be: a few milliseconds
look like other tissue. `direct` fits the delay (`estimators.delayed_problem`). The network has learnt presses that
begin at their time stamp only; it estimates the contact as if it had begun at several instants, evenly spread, and
these estimates are taken together. They count alike: so far apart, how well each explains the motion is no guide.
`python -m evaluation.benchmark --suite late-onset --onset between`, or without that option, shows what it is worth.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from data.samples import ContactCase

BETWEEN, STAMP = "between", "stamp"
ONSETS = (BETWEEN, STAMP)
"""A press begins anywhere within a frame interval of the first frame in contact, or at that frame's time stamp."""
INSTANTS = 5
"""Beginnings that are tried."""


def onset_error(onset: str, fps: float) -> float:
    """How far from the first frame in contact a press may begin, at so many frames a second [s]."""
    return 1 / fps if onset == BETWEEN else 0.0


def begun_otherwise(case: ContactCase, within: float, time_step: float, least: int) -> list[ContactCase]:
    """The contact as if it had begun at other instants; itself alone where it began at its time stamp.

    Args:
        case: the contact.
        within: how far from the time stamp it may have begun [s].
        time_step: of the case's steps [s].
        least: instants that leave fewer observations are left out, unless none remains.
    """
    if not within:
        return [case]
    found = []
    for delay in np.rint(np.linspace(-within, within, INSTANTS) / time_step).astype(int):
        steps = case.steps - delay
        kept = steps >= 0  # before it begins the tissue is at rest and tells nothing
        parts = {"steps": steps[kept], "displacement": case.displacement[kept], "weight": case.weight[kept]}
        if kept.sum() >= least:
            found.append(dataclasses.replace(case, **parts))
    return found or [case]


def together(means: np.ndarray, covariances: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean [D] and covariance [D, D] of several distributions that count alike, shapes [n, D] and [n, D, D]."""
    mean = means.mean(axis=0)
    apart = means - mean
    return mean, covariances.mean(axis=0) + apart.T @ apart / len(means)
