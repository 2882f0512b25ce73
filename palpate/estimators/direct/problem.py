"""One observed contact as a least-squares problem: where to start, what explains it best."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from palpate.data.contact.interaction import Interaction
from palpate.estimators.direct.motion import Kind, PressMotion
from palpate.observations.base import JointLikelihood
from palpate.observations.depth import DepthObservation
from palpate.physics.identifiability import fisher_information
from palpate.physics.likelihood import LeastSquares
from palpate.physics.mechanics import Mechanics

STARTS = 6
"""Fits, begun at the candidates that explain the data best."""
DELAYS = np.linspace(-1, 1, 17)
"""Delays that are tried for every start, in units of the largest."""
APART = 0.1
"""Starts are farther apart than this share of the box, in stiffness or damping: neighbours end in the same optimum."""


def dent_problem(
    contact: Interaction,
    mechanics: Mechanics,
    within: float = 0.0,
    noise: float | None = None,
    kind: Kind = PressMotion,
) -> JointLikelihood:
    """Return a depth-change sequence under all parameters of a press; what the pixels show must be decided first
    (`look`).

    Args:
        contact: with a depth-change sequence of one frame or more.
        mechanics: of the fits.
        within: as in `PressMotion`.
        noise: σ of every pixel in every frame [scene units]; None = as the depth-change sequence says.
        kind: of motion: what is fitted of the press.
    """
    depth = DepthObservation(contact, noise, parts=kind.parts, astray=kind.astray, uneven=kind.uneven)
    return JointLikelihood([depth], partial(kind, contact, mechanics, within=within))


def chosen_starts(problem: JointLikelihood, box: np.ndarray) -> np.ndarray:
    """Return parameters with the smallest misfits among many, their delays in the middle, shape [at most STARTS, D].

    Observations change about in proportion to the force, so each candidate is tried with the force that suits it best.
    """
    coarse, tried, misfits = problem.coarser(), [], []
    candidates = evenly_spread(problem.press(box[0]), problem.press(box[1]))
    candidates[:, problem.motion.centred] = 0
    for logs in map(problem.started, candidates):
        coarse.look(logs)
        residual, jacobian = coarse.linearise(logs)
        shown = jacobian[:, 2]  # by log |F|
        logs[2:3], left = suiting_forces(shown[None], shown - residual, logs[2:3], *box[:, 2])
        tried.append(logs)
        misfits.append(float(left[0]))
    return apart(np.array(tried), np.array(misfits), *box, STARTS)


def evenly_spread(low: np.ndarray, high: np.ndarray, count: int = 128) -> np.ndarray:
    """Return points of a Sobol sequence over a box of D parameters, a power of two of them, shape [count, D].

    So many since an under-damped response has many local optima, one for every number of swings.
    """
    from scipy.stats.qmc import Sobol  # takes seconds to load

    return low + Sobol(len(low), rng=0).random(count) * (high - low)


def suiting_forces(
    paths: np.ndarray, observed: np.ndarray, forces: np.ndarray, low: float, high: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return forces with which motions explain an observation best, as they are about proportional to them.

    Args:
        paths: C motions, shape [C, ...]; what isn't a number counts for nothing.
        observed: shape as in one motion.
        forces: log |F| by which the motions were simulated, shape [C].
        low, high: ends of log |F|.

    Returns:
        log |F|, and the sum of the squares that are left unexplained, shape [C] each.
    """
    valid = np.isfinite(paths) & np.isfinite(observed)
    tried, wanted = (np.where(valid, each, 0.0).reshape(len(paths), -1) for each in (paths, observed))
    factors = (tried * wanted).sum(axis=1) / np.maximum(np.square(tried).sum(axis=1), 1e-30)
    found = np.clip(forces + np.log(np.maximum(factors, 1e-9)), low, high)
    return found, np.square(np.exp(found - forces)[:, None] * tried - wanted).sum(axis=1)


def apart(logs: np.ndarray, misfits: np.ndarray, low: np.ndarray, high: np.ndarray, count: int) -> np.ndarray:
    """Return the points [C, D] with the smallest misfits [C] that lie `APART` in the box, shape [at most `count`,
    D]."""
    chosen: list[int] = []
    for index in np.argsort(misfits):
        distances = np.abs(logs[chosen] - logs[index])[:, :2] / (high - low)[:2]
        if (distances.max(axis=1, initial=0) > APART).all() or not chosen:
            chosen.append(int(index))
        if len(chosen) == count:
            break
    return logs[chosen]


class Optimum(NamedTuple):
    """A local optimum of the misfit."""

    logs: np.ndarray
    """φ, shape [3]."""
    cost: float
    """Half of χ²."""
    information: np.ndarray
    """Fisher information of φ, shape [3, 3]."""


def find_optimum(
    problem: LeastSquares, start: np.ndarray, box: np.ndarray, evaluations: int = 60, fall: float = 0.0
) -> Optimum:
    """Find the optimum that a fit from φ = `start` [3] within the box [2, 3] ends in, or how far it comes.

    Args:
        problem: what is fitted.
        start: of all parameters, shape [D].
        box: lower and upper ends of all parameters, shape [2, D].
        evaluations: after which it stops.
        fall: of χ²/2 in a step, below which it stops as well.
    """
    value = 0.5 * float(np.square(problem.residual(start)).sum()) if fall else 1.0
    end = least_squares(
        problem.residual, start, problem.jacobian, tuple(box), method="trf", x_scale="jac",
        ftol=max(1e-6, fall / max(value, fall)), xtol=1e-6, gtol=1e-6, max_nfev=evaluations
    )  # fmt: skip
    return Optimum(end.x, end.cost, fisher_information(end.jac, 1.0))


def evidence_shares(optima: Sequence[Optimum], prior: np.ndarray) -> np.ndarray:
    """Return the evidence of optima by Laplace's method relative to the likeliest, shape [O]; arguments as in
    `combine`."""
    volumes = [-0.5 * np.linalg.slogdet(optimum.information + prior)[1] for optimum in optima]
    logs = np.array([volume - optimum.cost for volume, optimum in zip(volumes, optima, strict=True)])
    return np.exp(logs - logs.max())


def combine(optima: Sequence[Optimum], prior: np.ndarray) -> tuple[np.ndarray, np.ndarray, Optimum]:
    """Return mean [3] and covariance [3, 3] of φ over several optima, and the likeliest of them.

    Each optimum stands for a normal distribution whose share is its evidence by Laplace's method: exp(-χ²/2) times the
    volume of φ that explains the data as well. A slightly worse fit of many φ can be likelier than the best of few.

    Args:
        optima: at least one.
        prior: information of the admissible box, which limits that volume, shape [3, 3].
    """
    shares = evidence_shares(optima, prior)
    # Optima with less than this share of the likeliest one's evidence are left out.
    shares = np.where(shares < 1e-3, 0.0, shares)
    shares /= shares.sum()
    places = np.array([optimum.logs for optimum in optima])
    mean = shares @ places
    apart = np.einsum("o,op,oq->pq", shares, places - mean, places - mean)
    shared = zip(shares, optima, strict=True)
    within = sum(share * np.linalg.inv(optimum.information + prior) for share, optimum in shared)
    return mean, within + apart, optima[int(np.argmax(shares))]


def distinct(optima: Sequence[Optimum]) -> list[Optimum]:
    """Return the optima without those that another start found as well, the best first."""
    kept: list[Optimum] = []
    for optimum in sorted(optima, key=lambda item: item.cost):
        # Optima nearer to each other than this in every log-parameter are one.
        if all(np.abs(optimum.logs - other.logs).max() > 0.05 for other in kept):
            kept.append(optimum)
    return kept
