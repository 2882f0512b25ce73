"""The numbers of an ablation's row, whatever was ablated: errors of log θ over bounds, and whether intervals hold."""

from __future__ import annotations

import numpy as np

from evaluation.recovery.scores import PARAMETERS, coverage, rms
from physics.identifiability import LIMIT

RATIO_ERRORS = ("stiffness_damping", "force_damping")
"""log k_s/k_d and log F/k_d, as columns are named."""
NUMBERS = (
    "judged",
    *(f"over_bound_{name}" for name in PARAMETERS),
    *(f"constant_over_bound_{name}" for name in PARAMETERS),
    *(f"rms_{name}" for name in RATIO_ERRORS),
    *(f"coverage_{name}" for name in PARAMETERS),
    "next_depth_over_copy",
)
"""Columns of a row's numbers."""


def numbers(
    errors: np.ndarray, constant_errors: np.ndarray, bounds: np.ndarray, sd: np.ndarray
) -> dict[str, float | None]:
    """A row's NUMBERS but `next_depth_over_copy`; what doesn't exist is None.

    Args:
        errors: estimated minus true `recovery_scores.QUANTITIES` in logarithms, shape [n, 5].
        constant_errors: the same of the best constant, shape [n, 5].
        bounds: Cramér–Rao bounds of a contact's whole first second, shape [n, 5].
        sd: standard deviations of the estimates as the network gives them, shape [n, 5]; not a number where none.

    Returns:
        `judged` (contacts with any parameter identifiable), RMS errors of k_s, k_d, F divided by the RMS bound over the
        contacts whose bound is below the limit, the constant's, RMS errors of k_s/k_d and F/k_d over all contacts, and
        the share of 90 % intervals that hold the truth, over the former contacts.
    """
    used = bounds[:, : len(PARAMETERS)] < LIMIT
    found: dict[str, float | None] = {"judged": int(used.any(axis=1).sum())}
    for column, name in enumerate(PARAMETERS):
        some = used[:, column]
        limit = rms(bounds[some, column])
        for label, values in (("over_bound", errors), ("constant_over_bound", constant_errors)):
            error = rms(values[some, column])
            found[f"{label}_{name}"] = None if error is None else error / limit  # ty: ignore[unsupported-operator]  of the same contacts
        found[f"coverage_{name}"] = coverage(errors[some, column], sd[some, column])
    for column, name in enumerate(RATIO_ERRORS, len(PARAMETERS)):
        found[f"rms_{name}"] = rms(errors[:, column])
    return found
