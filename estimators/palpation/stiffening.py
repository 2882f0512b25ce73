"""How a curve of force over depth, or over a pull, stiffens, and what that says of forces beyond its largest depth.

The stiffness dF/dd grows from that at the least depth by laws of one number more: exp(b·d) (Fung 1967), (1 + b·d)^(1/q)
with q = 1 (second order) and others in LAWS. A curve rarely tells which, so that they are averaged over by evidence,
with the growth; force and stiffness at the least depth are integrated out (Bayesian linear regression, flat priors).
What a law leaves is correlated, so that samples are averaged in bins and count by their residuals' autocorrelation.
"""

from dataclasses import dataclass

import numpy as np

BINS = 16
"""At most, evenly over depth: laws err alike at samples closer together."""
LAWS = np.array(
    [
        *((0, 1, 0), (0.5, 1, 0), (1, 1, 0), (2, 1, 0), (-0.5, 1, 0), (0, 2, 0), (0.5, 2, 0), (1, 2, 0)),
        *((0, 4, 4), (1, 4, 4), (1, 8, 20)),
    ],
    np.float64,
)
"""q, p and t of a stiffness (1 + c·s)^(1/q) over the depth x, 1 at the largest, with s = (1 + t)·xᵖ/(1 + t·xᵖ); q = 0:
exp(c·s). Below 0 it locks, with t above 0 it levels off as of fibres that are taut. As likely before."""
GROWTH = np.linspace(-1.0, 4.5, 111)
"""Logarithm of the stiffness at the largest over that at the least depth, as likely before; 0 is among them."""
FLOOR = 0.004
"""Root mean square of what the best law leaves, at least, over the range of the forces."""
ASKED = 20.0
"""Odds from which on the evidence asks for stiffening."""
OTHER_LAW = 0.13, 0.18
"""Standard deviations, down and up, of the logarithm of a force at twice the largest depth, for laws that are none of
these: more of these stiffen faster than slower. They grow with the root of the depth beyond the largest, since tissue
that locks leaves these laws at once."""
HAZARD, STEEPEST = 0.6, 15.0
"""How often slack fibres grow taut per range of depths beyond a curve that is straight so far, and stiffness over that
at the least depth up to which they then raise it, uniformly in its logarithm."""
WIDEST = 1.25
"""Factor between a value and either end of its interval, up to which it is told."""
DRAWS = 2000
INTERVAL = (0.5, 0.05, 0.95)
"""Median and ends of a 90 % interval."""
NODES, WEIGHTS = np.polynomial.legendre.leggauss(12)


@dataclass(frozen=True, eq=False)
class Stiffening:
    """What a curve says, as M draws from the posterior."""

    begin: float
    end: float
    """Least and largest depth [mm]."""
    stiffens: bool
    """Whether the evidence asks for a growing stiffness."""
    offset: np.ndarray
    """Force at the least depth, shape [M] [N]."""
    slope: np.ndarray
    """Stiffness there times the range of depths, shape [M] [N]."""
    growth: np.ndarray
    """As GROWTH, shape [M]."""
    law: np.ndarray
    """Which of LAWS, shape [M]."""
    noise: np.ndarray
    """What a sample differs from the law by, shape [M] [N]."""

    @property
    def numbers(self) -> np.ndarray:
        """The stiffness at the least depth [N/mm], and by how much its logarithm grows in the mean, Fung's b [1/mm].

        Median and 90 % interval, shape [2, 3].
        """
        return np.quantile(np.stack([self.slope, self.growth]) / (self.end - self.begin), INTERVAL, axis=1).T

    def force(self, depth: np.ndarray) -> np.ndarray:
        """A sample's force at depths, shape [Q] [mm]: median and 90 % interval, shape [3, Q] [N]."""
        chance = np.random.default_rng(0)
        x = (depth - self.begin) / (self.end - self.begin)
        beyond = np.clip(x - 1, 0, 10)
        risen = _risen(x, self.growth, self.law)
        # Fibres that are all taut stiffen no further: half of the draws lie between their law and its last tangent.
        tangent = _risen(np.minimum(x, 1), self.growth, self.law) + beyond * np.exp(self.growth)[:, None]
        taut = np.maximum(chance.uniform(-1, 1, (len(risen), 1)), 0)
        risen = risen + taut * np.minimum(tangent - risen, 0)
        # And slack ones may grow taut further on, at any depth; the less likely, the more a curve has stiffened.
        begins = chance.exponential(np.exp(np.maximum(self.growth, 0) / 2)[:, None] / HAZARD)
        more = np.exp(chance.uniform(0, 1, len(risen)) * np.maximum(np.log(STEEPEST) - self.growth, 0))
        risen = risen + ((more - 1) * np.exp(self.growth))[:, None] * np.maximum(beyond - begins, 0)
        force = self.offset[:, None] + self.slope[:, None] * risen
        other = chance.standard_normal((len(risen), 1))
        other = np.exp(np.where(other < 0, *OTHER_LAW) * other * np.sqrt(beyond))
        return np.quantile(force * other + self.noise[:, None], INTERVAL, axis=0)


def told(value: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Which intervals of positive numbers reach up and down by a factor of WIDEST at most."""
    return (low > 0) & (high <= WIDEST * value) & (value <= WIDEST * low)


def fit_stiffening(depth: np.ndarray, force: np.ndarray) -> Stiffening:
    """Fit a curve.

    Args:
        depth: rising, not all the same, shape [D] [mm].
        force: shape [D] [N].
    """
    begin, end = float(depth.min()), float(depth.max())
    x = (depth - begin) / (end - begin)
    bins = np.minimum((BINS * x).astype(int), BINS - 1)
    kept, count = np.unique(bins, return_counts=True)
    every, (x, force) = (x, force), (np.bincount(bins, each)[kept] / count for each in (x, force))
    growth, law = (each.ravel() for each in np.meshgrid(GROWTH, np.arange(len(LAWS))))
    scale = _risen(np.ones(1), growth, law)
    # Over what the law rises by in all, so that the flat prior is of forces.
    root = np.stack(np.broadcast_arrays(1.0, _risen(x, growth, law) / scale), axis=2)
    inverse = np.linalg.inv(root.swapaxes(1, 2) @ root)
    best = np.einsum("gij,gnj,n->gi", inverse, root, force)
    left = force - np.einsum("gni,gi->gn", root, best)
    square = np.square(left).sum(axis=1)
    floor = len(x) * (FLOOR * float(np.ptp(force))) ** 2 + 1e-30
    least = left[square.argmin()]
    alike = max(float(least[1:] @ least[:-1]) / (float(least @ least) + floor), 0.0)
    freedom = max(len(x) * (1 - alike) / (1 + alike) - 3, 1.0)
    square += floor
    evidence = -0.5 * freedom * np.log(square) + 0.5 * np.linalg.slogdet(inverse)[1]
    weight = np.exp(evidence - evidence.max())
    stiffens = weight[growth > 1e-9].mean() > ASKED * weight[np.abs(growth) < 1e-9].mean()
    chance = np.random.default_rng(0)
    drawn = chance.choice(len(weight), DRAWS, p=weight / weight.sum())
    spread = np.sqrt(square[drawn] / chance.chisquare(freedom, DRAWS))
    shift = np.linalg.cholesky(inverse[drawn]) @ chance.standard_normal((DRAWS, 2, 1))
    offset, rise = (best[drawn] + spread[:, None] * shift[..., 0]).T
    noise = spread * np.sqrt(freedom / max(len(x) - 3, 1))
    # Of a sample, not of a bin's mean.
    top, (at, measured) = [square.argmin()], every
    apart = measured - best[top[0]] @ [np.ones(len(at)), _risen(at, growth[top], law[top])[0] / scale[top[0]]]
    noise = np.maximum(noise, apart.std()) * chance.standard_normal(DRAWS)
    return Stiffening(begin, end, bool(stiffens), offset, rise / scale[drawn, 0], growth[drawn], law[drawn], noise)


def _risen(x: np.ndarray, growth: np.ndarray, law: np.ndarray) -> np.ndarray:
    """Integral of the stiffness from 0 to x, shape [Q], over that at 0, shape [M, Q], by Gauss and Legendre."""
    power, bend, taut = LAWS[law].T[..., None, None]
    at = (x[:, None] * (NODES + 1) / 2) ** bend
    at = at * (1 + taut) / (1 + taut * at)
    fung = np.exp(np.minimum(growth[:, None, None] * at, 300))
    base = np.maximum(1 + np.expm1(power * growth[:, None, None]) * at, 1e-3)
    stiffness = np.where(power == 0, fung, base ** (1 / np.where(power == 0, 1, power)))
    return x / 2 * (stiffness @ WEIGHTS)
