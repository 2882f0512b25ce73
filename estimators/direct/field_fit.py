"""A whole dent fitted from start to verdict: starts, optima, posterior, estimate."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from palpate.data.contact.interaction import Interaction
from palpate.estimators.direct.contact_fit import LEAST_SHARE, TOO_FEW, WIDER, concluded
from palpate.estimators.direct.field import SequenceProblem
from palpate.estimators.direct.motion import PressMotion
from palpate.estimators.direct.patch import PatchMotion
from palpate.estimators.direct.problem import (
    CANDIDATES,
    DELAYS,
    Optimum,
    apart,
    combine,
    distinct,
    evidence_shares,
    find_optimum,
)
from palpate.estimators.direct.sampling import Draws, Mixture, sample_posterior
from palpate.estimators.estimate import Estimate
from palpate.physics.identifiability import box_information
from palpate.physics.mechanics import Mechanics

FITS = 3
"""Starts that are fitted to the end; where there are more, the best of them."""
FEW = 4
"""Evaluations of a start in a round, after which it is decided anew what the pixels show. With 8 rounds took twice as
long, and led no farther (five validation clips of presses on patches)."""
REFUTED = 20.0
"""Optima whose misfit is so much larger than the best one's are out [nats]."""
ROUND = 64
"""Draws of a round; a power of two."""
ENOUGH = 100.0
"""Effective draws that are enough: the mean is then within a tenth of a standard deviation. A draw takes as long as
ten of a single point's."""
TAIL = 3.0
"""Half of the first draws are spread so many times as far as the optima say, as far as the box allows (a defensive
mixture, Hesterberg 1995). Only inertia tells the common scale of k_s, k_d and F, and the less the larger that is:
towards firm tissue the posterior has a long tail. Draws as narrow as an optimum miss it, and don't know that."""
LEAST_EXCESS, REFUTES = 1.1, 5.0
"""A step on a vertex is refuted by a larger misfit than the first, if its square lies more standard deviations above 1
than the second: 16 patches of validation clips gave 23 and more, with misfits from 1.2 on."""
NARROW = 0.1
"""Where all standard deviations of log θ are smaller the posterior is as good as normal, and needs no draws."""


def fit_field(problem: SequenceProblem[PressMotion], tissue: np.ndarray) -> Estimate:
    """Fit a depth-change sequence; `tissue` is the box of φ, shape [2, 3].

    Where the contact is pressed aslant to the line of sight its uncertainty is widened (`estimators.oblique`).
    """
    return sampled(problem, field_optima(problem, tissue), tissue)


def field_optima(problem: SequenceProblem[PressMotion], tissue: np.ndarray) -> list[Optimum]:
    """Optima of a sequence's fit, the best first; the problem has looked at that one. Arguments as of `fit_field`."""
    box = problem.motion.box(tissue)
    found = []
    for logs in raced(problem.coarser(), field_starts(problem, box), box):
        problem.look(logs)
        found.append(find_optimum(problem, logs, *box))
    optima = distinct(found)
    for _ in range(problem.motion.looks):
        problem.look(optima[0].logs, finer=True, outliers=True)
        optima = distinct([find_optimum(problem, optimum.logs, *box) for optimum in optima])
        optima = [optimum for optimum in optima if optimum.cost < optima[0].cost + REFUTED]
    return optima


def sampled(problem: SequenceProblem[PressMotion], optima: Sequence[Optimum], tissue: np.ndarray) -> Estimate:
    """What optima of a sequence's fit say: the posterior around them and its verdict; `tissue` as of `fit_field`."""
    box = problem.motion.box(tissue)
    prior = box_information(box)
    mean, spread, best = combine(optima, prior)
    scale = max(1.0, problem.misfit(best.logs)) ** 2
    spread, draws = scale * spread, None
    if problem.motion.sampled and (len(optima) > 1 or (np.diag(spread)[:3] > NARROW**2).any()):
        found = _sample(problem, optima, best, box, scale)
        draws = found if found.effective >= TOO_FEW else None
    return concluded(problem, box, optima, best, (mean, spread), draws, outliers=problem.outliers)


def fit_press(
    contact: Interaction, mechanics: Mechanics, within: float, noise: float | None, tissue: np.ndarray
) -> Estimate:
    """Fit a depth-change sequence by a step on the contact vertex and, where that is refuted, by a press of any shape.

    The shape (`estimators.direct.patch`) is kept where it explains more than so many further parameters would by
    chance (Schwarz 1978).

    Args:
        contact, mechanics, within, noise: as of `SequenceProblem.of_press`.
        tissue: the box of φ, shape [2, 3].
    """
    step = SequenceProblem.of_press(contact, mechanics, within, noise)
    plain = field_optima(step, tissue)
    # Whether a step is refuted shows before its posterior is sampled, which takes as long as all the rest.
    best = combine(plain, box_information(step.motion.box(tissue)))[2]
    misfit, counted = step.misfit(best.logs), step.counted
    if misfit < LEAST_EXCESS or (misfit**2 - 1) * math.sqrt(counted / 2) < REFUTES:
        return sampled(step, plain, tissue)
    patch = SequenceProblem.of_press(contact, mechanics, within, noise, PatchMotion)
    shaped = fit_field(patch, tissue)
    further = patch.motion.box(tissue).shape[1] - step.motion.box(tissue).shape[1]
    explained = counted * (misfit**2 - shaped.misfit**2)
    return shaped if explained > further * math.log(counted) else sampled(step, plain, tissue)


def field_starts(problem: SequenceProblem[PressMotion], box: np.ndarray) -> np.ndarray:
    """Parameters with the smallest misfits among many, each with the force and the delay that suit it best, [S, D].

    Tissue is taken to stay in its pixels, which is true of most of a dent.
    """
    from scipy.stats.qmc import Sobol  # takes seconds to load

    low, high = box
    motion, sequence = problem.motion, problem.sequence
    candidates = low + Sobol(len(low), rng=0).random(CANDIDATES) * (high - low)
    candidates[:, motion.centred] = 0
    delays = DELAYS if motion.within else np.zeros(1)
    observed = problem.observed
    still = problem.patches.covering(np.zeros((len(sequence.times), len(problem.patches.vertices), 3)))
    misfits = np.empty(len(candidates))
    for index, candidate in enumerate(candidates):
        path, ratio = motion.coarse_path(candidate)
        step = ratio * motion.mechanics.time_step
        sunk = np.concatenate([np.zeros((1, path.shape[1])), problem.patches.sunk(path.astype(np.float64))])
        since = motion.times - motion.within * delays[:, None]
        places = np.clip(np.rint(since / step), 0, len(path)).astype(np.int64)
        tried = problem.patches.shown(sunk[places.ravel()], np.tile(still, (len(delays), 1, 1)))
        tried = tried.reshape(len(delays), *observed.shape)
        seen = np.isfinite(tried) & np.isfinite(observed)
        tried, left = np.where(seen, tried, 0.0), np.where(seen, observed, 0.0)
        squares = np.square(tried).sum(axis=(1, 2))
        factors = np.maximum((tried * left).sum(axis=(1, 2)), 1e-12) / np.maximum(squares, 1e-30)
        forces = np.clip(candidate[2] + np.log(np.maximum(factors, 1e-9)), low[2], high[2])
        unexplained = np.square(np.exp(forces - candidate[2])[:, None, None] * tried - left).sum(axis=(1, 2))
        best = int(np.argmin(unexplained))
        misfits[index], candidate[2], candidate[motion.delays] = unexplained[best], forces[best], delays[best]
    return apart(candidates, misfits, low, high, motion.starts)


def raced(problem: SequenceProblem[PressMotion], starts: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Of starts [S, D] those that lead farthest, and where to: at most FITS, by successive halving.

    Every round (Jamieson & Talwalkar 2016) decides for every start anew what the pixels show, and leaves the better
    half.

    Args:
        problem: of coarse time steps.
        starts: as of `field_starts`; FITS of them or fewer stay as they are.
        box: of all parameters, shape [2, D].
    """
    while len(starts) > FITS:
        led = []
        for logs in starts:
            problem.look(logs)
            found = find_optimum(problem, logs, *box, FEW)
            # What comes out of sight must not seem explained.
            led.append((found.cost - 0.5 * problem.seen.sum(), found.logs))
        led.sort(key=lambda pair: pair[0])
        starts = np.array([logs for _, logs in led[: len(led) // 2]])
    return starts


def first_draws(optima: Sequence[Optimum], scale: float, prior: np.ndarray) -> Mixture:
    """Where the first draws of a posterior come from: around its optima, and as many from its tails.

    Args:
        optima: at least one; D parameters.
        scale: σ² is so many times as large as the optima take it to be.
        prior: information of the admissible box, shape [D, D].
    """
    shares = np.maximum(evidence_shares(optima, prior), LEAST_SHARE)
    widths = [WIDER * np.linalg.inv(o.information / (scale * wide**2) + prior) for wide in (1.0, TAIL) for o in optima]
    places = np.array([optimum.logs for optimum in optima])
    return Mixture(np.tile(0.5 * shares / shares.sum(), 2), np.tile(places, (2, 1)), np.array(widths))


def _sample(
    problem: SequenceProblem[PressMotion], optima: Sequence[Optimum], best: Optimum, box: np.ndarray, scale: float
) -> Draws:
    """The posterior around the optima, σ² being `scale` times as large as the depth-change sequence says."""
    prior = box_information(box)
    error = problem.motion.finer(best.logs) - problem.motion.quick(best.logs)

    def likelihoods(logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values = []
        for item in logs:
            left = problem.left(problem.motion.quick(item) + error, item)
            values.append(-0.5 * float(left @ left) / scale)
        found = np.array(values).reshape(-1, 1)
        return found, found

    start = first_draws(optima, scale, prior)
    none = np.empty((0, len(best.logs)))
    return sample_posterior(likelihoods, box, start, (none, likelihoods(none)), ROUND, ENOUGH)
