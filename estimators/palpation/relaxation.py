"""How the force on an indenter falls while its depth is held: standard linear solids side by side.

Quasi-linear viscoelasticity (Fung 1993, section 7.6): F(t) = ∫ G(t - s) dFₑ(d(s)), with the elastic answer
Fₑ = (e^(b·d) - 1)/(e^(b·d_max) - 1) and G(t) = w₀ + Σ wⱼ e^(-t/τⱼ), wⱼ ≥ 0. One branch is the standard linear solid
(Findley 1976, section 5.3). Tissue relaxes over all times at once, so the default has branches at fixed times, two a
decade, from a sample's spacing to three times what was observed; weights are the non-negative least squares'.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize, minimize_scalar, nnls

from palpate.estimators.palpation.curves import LEAST, Hold
from palpate.physics.fem import Relaxation

A_DECADE = 2
"""Branches."""
AHEAD = 3.0
"""Longest branch over what was observed of the hold: slower ones look like one that never relaxes."""
STIFFENING = (0.01, 10.0)
"""Within which b·d_max is looked for: from a straight line to a force that doubles in the last tenth of the depth."""


@dataclass(frozen=True, eq=False)
class Viscoelastic:
    """A fitted answer; J branches."""

    stiffening: float
    """b [1/mm]."""
    deepest: float
    """d_max [mm]."""
    times: np.ndarray
    """τ, shape [J] [s]."""
    weights: np.ndarray
    """w₀ and wⱼ, shape [1 + J] [N]: of the force at d_max, were it reached at once."""
    noise: float
    """Root mean square of what is left where it was fitted [N]."""
    drift: float
    """How far off a forecast will be, by how far off the same fit to the first half of the seen hold was on the second
    [N]; not a number where too little was observed."""

    @property
    def relaxed_share(self) -> float:
        """w₀ over all weights: what remains of the force in the end."""
        return float(self.weights[0] / self.weights.sum())

    @property
    def solid(self) -> Relaxation | None:
        """The standard linear solid, where there is one branch and something remains of the force in the end."""
        if len(self.times) != 1 or not self.weights.all():
            return None
        return Relaxation(float(self.weights[1] / self.weights[0]), float(self.times[0]))

    def force(self, times: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Force while a depth [mm] is driven at times [s], both of shape [T], in newtons."""
        return _design(times, depth, self.deepest, self.stiffening, self.times) @ self.weights

    @property
    def forecast_sd(self) -> float:
        """Standard deviation of the force after what was fitted, for as long again [N]."""
        return float(np.hypot(self.noise, self.drift))


def fit_relaxation(hold: Hold, until: float | None = None, *, branches: int | None = None) -> Viscoelastic:
    """Fit an indentation that is held.

    Args:
        hold: as read.
        until: time of the last sample that is fitted [s]; None = all.
        branches: 1 = a standard linear solid, whose time is fitted; None = branches at fixed times.

    Raises:
        ValueError: fewer than LEAST samples of the hold are fitted, or another number of branches.
    """
    if branches not in (None, 1):
        raise ValueError(f"branches is {branches}; give 1, or none for fixed times.")
    found, seen = _fit(hold, until, branches)
    begun = hold.times[hold.held][0]
    drift = float("nan")
    held = hold.held & seen
    middle = (begun + hold.times[held][-1]) / 2
    if (held & (hold.times <= middle)).sum() >= LEAST:
        early, _ = _fit(hold, middle, branches)
        after = held & (hold.times > middle)
        missed = early.force(hold.times, hold.depth)[after] - hold.force[after]
        drift = float(np.sqrt(np.mean(np.square(missed))))
    return replace(found, drift=drift)


def _fit(hold: Hold, until: float | None, branches: int | None) -> tuple[Viscoelastic, np.ndarray]:
    """The fit without its drift, and which samples it saw."""
    seen = np.ones(len(hold.times), bool) if until is None else hold.times <= until
    held = hold.held & seen
    if held.sum() < LEAST:
        raise ValueError(f"{int(held.sum())} samples of the hold are to be fitted; give {LEAST} or more.")
    deepest = float(hold.depth.max())
    shortest = float(np.median(np.diff(hold.times)))
    longest = AHEAD * float(np.ptp(hold.times[held]))
    low, high = (float(np.log(limit / deepest)) for limit in STIFFENING)

    def solve(stiffening: float, times: np.ndarray) -> tuple[np.ndarray, float]:
        design = _design(hold.times[seen], hold.depth[seen], deepest, stiffening, times)
        return nnls(design, hold.force[seen])

    if branches is None:
        count = 1 + int(A_DECADE * np.log10(max(longest / shortest, 1.0)))
        times = shortest * 10.0 ** (np.arange(count) / A_DECADE)
        log = minimize_scalar(lambda value: solve(np.exp(value), times)[1], bounds=(low, high), method="bounded").x
    else:
        bounds = [(low, high), (np.log(shortest / 10), np.log(longest))]
        starts = [[(low + high) / 2, np.log(longest / part)] for part in (3, 30)]
        how = {"method": "Nelder-Mead", "bounds": bounds}
        fits = [minimize(lambda x: solve(np.exp(x[0]), np.exp(x[1:]))[1], start, **how) for start in starts]
        log, time = min(fits, key=lambda fit: fit.fun).x
        times = np.exp([time])
    stiffening = float(np.exp(log))
    weights, left = solve(stiffening, times)
    noise = float(left / np.sqrt(seen.sum()))
    return Viscoelastic(stiffening, deepest, times, weights, noise, float("nan")), seen


def _design(times: np.ndarray, depth: np.ndarray, deepest: float, stiffening: float, slow: np.ndarray) -> np.ndarray:
    """Force of w₀ and of every branch at weight 1, shape [T, 1 + J]; exact where the elastic answer is linear."""
    elastic = np.expm1(stiffening * depth) / np.expm1(stiffening * deepest)
    found = np.zeros((len(times), 1 + len(slow)))
    found[:, 0] = elastic
    found[0, 1:] = elastic[0]
    share = np.diff(times)[:, None] / slow
    kept = np.exp(-share)
    gained = np.diff(elastic)[:, None] * -np.expm1(-share) / share
    for step in range(len(share)):
        found[step + 1, 1:] = found[step, 1:] * kept[step] + gained[step]
    return found
