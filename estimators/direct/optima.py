"""What explains a contact's motion best: local optima by least squares, and what they weigh against each other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from estimators.direct.problem import ContactProblem
from physics.identifiability import fisher_information

TOLERANCE = 1e-6
MOST_EVALUATIONS = 60
SAME = 0.05
"""Optima nearer to each other than this in every log-parameter are one."""
NEGLIGIBLE = 1e-3
"""Optima with less than this share of the likeliest one's evidence are left out."""


class Optimum(NamedTuple):
    """A local optimum of the misfit."""

    logs: np.ndarray
    """φ, shape [3]."""
    cost: float
    """Half of χ²."""
    information: np.ndarray
    """Fisher information of φ, shape [3, 3]."""


def find_optimum(problem: ContactProblem, start: np.ndarray, low: np.ndarray, high: np.ndarray) -> Optimum:
    """The optimum that a fit from φ = `start` [3] within the box [3], [3] ends in."""
    end = least_squares(
        problem.residual, start, problem.jacobian, (low, high), method="trf",
        x_scale="jac", ftol=TOLERANCE, xtol=TOLERANCE, gtol=TOLERANCE, max_nfev=MOST_EVALUATIONS,
    )  # fmt: skip
    return Optimum(end.x, end.cost, fisher_information(end.jac, 1.0))


def evidence_shares(optima: Sequence[Optimum], prior: np.ndarray) -> np.ndarray:
    """Evidence of optima by Laplace's method relative to the likeliest, shape [O]; arguments as in `combine`."""
    volumes = [-0.5 * np.linalg.slogdet(optimum.information + prior)[1] for optimum in optima]
    logs = np.array([volume - optimum.cost for volume, optimum in zip(volumes, optima, strict=True)])
    return np.exp(logs - logs.max())


def combine(optima: Sequence[Optimum], prior: np.ndarray) -> tuple[np.ndarray, np.ndarray, Optimum]:
    """Mean [3] and covariance [3, 3] of φ over several optima, and the likeliest of them.

    Each optimum stands for a normal distribution whose share is its evidence by Laplace's method, exp(-χ²/2) times the
    volume of φ that explains the data as well: a slightly worse fit of many φ can be likelier than the best of few.

    Args:
        optima: at least one.
        prior: information of the admissible box, which limits that volume, shape [3, 3].
    """
    shares = evidence_shares(optima, prior)
    shares = np.where(shares < NEGLIGIBLE, 0.0, shares)
    shares /= shares.sum()
    places = np.array([optimum.logs for optimum in optima])
    mean = shares @ places
    apart = np.einsum("o,op,oq->pq", shares, places - mean, places - mean)
    within = sum(
        share * np.linalg.inv(optimum.information + prior) for share, optimum in zip(shares, optima, strict=True)
    )
    return mean, within + apart, optima[int(np.argmax(shares))]


def distinct(optima: Sequence[Optimum]) -> list[Optimum]:
    """The optima without those that another start found as well, the best first."""
    kept: list[Optimum] = []
    for optimum in sorted(optima, key=lambda item: item.cost):
        if all(np.abs(optimum.logs - other.logs).max() > SAME for other in kept):
            kept.append(optimum)
    return kept
