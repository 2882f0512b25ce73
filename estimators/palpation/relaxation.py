"""How the force on an indenter falls while its depth is held: a standard linear solid.

Quasi-linear viscoelasticity (Fung 1993, section 7.6): F(t) = ∫ G(t - s) dFₑ(d(s)), with the elastic answer
Fₑ = (e^(b·d) - 1)/(e^(b·d_max) - 1) and G(t) = w₀ + w₁ e^(-t/τ), w ≥ 0 (Findley 1976, section 5.3). Weights are the
non-negative least squares'. Tissue goes on relaxing where such a solid levels off (docs/reports/palpation.md).
"""

import numpy as np
from scipy.optimize import minimize, nnls

from palpate.estimators.palpation.curves import Hold
from palpate.physics.fem import Relaxation

AHEAD = 3.0
"""Longest τ over what was observed of the hold: a slower one looks like one that never relaxes."""
STIFFENING = (0.01, 10.0)
"""Within which b·d_max is looked for: from a straight line to a force that doubles in the last tenth of the depth."""


def fit_relaxation(hold: Hold) -> Relaxation | None:
    """Fit an indentation that is held; None where the force falls to nothing, or not at all."""
    deepest, shortest = float(hold.depth.max()), float(np.median(np.diff(hold.times)))
    longest = AHEAD * float(np.ptp(hold.times[hold.held]))

    def solve(logs: np.ndarray) -> tuple[np.ndarray, float]:
        return nnls(answers(hold.times, hold.depth, deepest, *np.exp(logs)), hold.force)

    low, high = (float(np.log(limit / deepest)) for limit in STIFFENING)
    how = {"method": "Nelder-Mead", "bounds": [(low, high), (np.log(shortest / 10), np.log(longest))]}
    starts = [[(low + high) / 2, np.log(longest / part)] for part in (3, 30)]
    fits = [minimize(lambda logs: solve(logs)[1], start, **how) for start in starts]
    best = min(fits, key=lambda fit: fit.fun).x
    weights, _ = solve(best)
    return Relaxation(float(weights[1] / weights[0]), float(np.exp(best[1]))) if weights.all() else None


def answers(times: np.ndarray, depth: np.ndarray, deepest: float, stiffening: float, slow: float) -> np.ndarray:
    """Force of w₀ and of the branch at weight 1 while a depth is driven; exact where the elastic answer is linear.

    Args:
        times: shape [T] [s].
        depth: shape [T] [mm].
        deepest: d_max [mm].
        stiffening: b [1/mm].
        slow: τ [s].

    Returns:
        shape [T, 2] [N].
    """
    elastic = np.expm1(stiffening * depth) / np.expm1(stiffening * deepest)
    found = np.stack([elastic, elastic], axis=1)
    share = np.diff(times) / slow
    kept, gained = np.exp(-share), np.diff(elastic) * -np.expm1(-share) / share
    for step in range(len(share)):
        found[step + 1, 1] = found[step, 1] * kept[step] + gained[step]
    return found
