"""Distance of a contact's observation from the simulated motion, in standard deviations, by one rollout.

Where a pixel of the grid is one of the picture, the contact's own point is compared. Where it is the mean of several,
it doesn't show the full depth of a dent's bottom, which is no wider; there the pixels around it are compared, each with
the mean of the tissue that it shows.
"""

import dataclasses
import math

import numpy as np
from scipy.linalg import block_diag
from scipy.special import gammainccinv

from palpate.data.contact.interaction import Interaction
from palpate.estimators.direct.motion import between_steps
from palpate.estimators.direct.problem import DELAYS
from palpate.physics.depth import MOVED, REACH, WALL, DepthLikelihood, DepthSequence
from palpate.physics.identifiability import fisher_information
from palpate.physics.load import held
from palpate.physics.mechanics import Mechanics, theta_of
from palpate.physics.msd.simulation import simulate_tangent

LARGEST_MISFIT = 1.5
"""Largest misfit [σ] of motions like those of the training. Beyond it the network's covariance is inflated by that of a
noise as large as the misfit, within the box."""
TAIL_PROBABILITY = 3.5e-4
"""Probability that noise alone takes 25 observations so far away; fewer may lie farther."""


class _PointComparison:
    """The followed point, along the force: M vertices, N instants, K of which are compared in full.

    `vertices` [M] are to be simulated, the contact's first. At `times` [N], instants after the onset [s], delays are
    found by one `observed` number each [scene units]; `compared_times` [K] are those that are compared in full.
    """

    def __init__(self, contact: Interaction) -> None:
        self.vertices, self.times, self.observed = np.array([contact.vertex]), contact.observation.times, contact.along
        self.compared_times, self.blurs = self.times, np.zeros((len(self.times), 0))
        self._direction, self._noise = np.asarray(contact.direction, np.float64), contact.noise

    def signal(self, path: np.ndarray) -> np.ndarray:
        """Return the number that `observed` holds, of simulated displacements [T, M, 3], shape [T]."""
        return path[:, 0] @ self._direction

    def residual(self, moved: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the residual of displacements at the compared instants [K, M, 3], shape [L] [σ], and its derivatives
        [L, D].

        `rates` are derivatives of the displacements by D parameters, shape [K, M, 3, D].
        """
        changes = np.einsum("nid,i->nd", rates[:, 0], self._direction)
        return (self.signal(moved) - self.observed) / self._noise, changes / self._noise


class _PixelComparison:
    """The pixels around the contact that move; names as in `_PointComparison`."""

    def __init__(self, contact: Interaction, sequence: DepthSequence) -> None:
        # Most frames, evenly chosen, and rows and columns from the contact that are compared.
        frames, reach = np.unique(np.linspace(0, len(sequence.times) - 1, 8).round().astype(int)), 2
        self._depth = DepthLikelihood(contact.mesh, contact.vertex, sequence.chosen(frames), reach=reach, partial=WALL)
        self.times, self.compared_times = sequence.times, self._depth.times
        self.blurs = np.zeros((0, 2))
        """Change of the residual by what the depth's resolution may be, shape [L, 2] [σ], at the latest
        displacements."""
        self.vertices = np.append(contact.vertex, self._depth.vertices)
        near = np.s_[REACH - reach : REACH + reach + 1]
        change = sequence.change[:, near, near].reshape(len(sequence.times), -1).astype(np.float64)
        # Pixels that are never hidden; together they show nearly the same tissue all the time.
        own = self._depth.patches.own()
        clear = np.isfinite(change).all(axis=0) & (own >= 0)
        self._shown, self.observed = own[clear], np.full(len(change), np.nan)
        if clear.any():
            self.observed = change[:, clear].mean(axis=1)

    def signal(self, path: np.ndarray) -> np.ndarray:
        return self._depth.patches.sunk(path[:, 1 + self._shown], self._shown).mean(axis=1)

    def residual(self, moved: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        depth, motion = self._depth, (moved[:, 1:], rates[:, 1:])
        change = depth.see(motion[0])
        used = depth.seen & (np.abs(change) > MOVED * depth.noise.total).any(axis=0)
        self.blurs = depth.singly(depth.blurs.swapaxes(0, 1), used)
        return depth.singly(change - depth.observed, used), depth.singly(depth.tangent(*motion), used)


_Comparison = _PointComparison | _PixelComparison


def _comparison(contact: Interaction) -> _Comparison:
    """Return the comparison for a contact: of pixels where there are any, else of the followed point."""
    sequence = contact.sequence
    if sequence is not None and len(sequence.times) and sequence.is_finer_than(contact.mesh.grid_shape):
        found = _PixelComparison(contact, sequence)
        if np.isfinite(found.observed).all():
            return found
    return _PointComparison(contact)


def largest_misfit(count: int) -> float:
    """Return the largest root mean square [σ] of so many observations that noise may explain."""
    return max(LARGEST_MISFIT, math.sqrt(2 * float(gammainccinv(count / 2, TAIL_PROBABILITY)) / count))


def compared(
    contact: Interaction, mechanics: Mechanics, logs: np.ndarray, covariance: np.ndarray, within: float
) -> tuple[float, np.ndarray, bool]:
    """Compare a contact's motion with the simulated one, and find its information on φ if its instants are known.

    Args:
        contact: with its observation.
        mechanics: constants of the simulation.
        logs, covariance: posterior of φ, shapes [3] and [3, 3]; the motion is compared with the nearest that it allows.
        within: the press began, and ended, at most so long before or after the time stamps [s]; the delays are those
            that explain the motion best.

    Returns:
        Root mean square of the residual [σ], the Fisher information [3, 3] of the contact's motion, and
        whether depth shows the dent blurred, unlike in the training.
    """
    step, theta, comparison = mechanics.time_step, theta_of(logs), _comparison(contact)
    instants = contact.observation.steps(step)
    steps = max(int(instants.max()), round(comparison.times[-1] / step) - 1) + 1 + math.ceil(within / step)
    loaded = contact.load_seconds if contact.released else math.inf

    def simulated(seconds: float) -> np.ndarray:
        """Return displacements and their derivatives by φ under a press of this duration, shape [T, M, 3, 4]."""
        press = dataclasses.replace(contact.load, factor=held(seconds / step, steps))
        path, slopes = simulate_tangent(theta, contact.mesh, press, mechanics, watch=comparison.vertices)
        return np.concatenate([path[..., None], slopes], axis=-1)

    motion, prior = simulated(loaded), np.linalg.inv(covariance)
    information = fisher_information(motion[instants, 0, :, 1:].reshape(-1, len(logs)), contact.noise)
    if not within:
        at = motion[np.rint(comparison.compared_times / step).astype(np.int64) - 1]
        residual, slopes = comparison.residual(at[..., 0], at[..., 1:])
        left = residual + slopes @ _nearest(residual, slopes, prior)
        return _rms(left), information, _blurred(residual, slopes, comparison.blurs, prior)
    pressed = max(1, round(contact.load_seconds / step)) if contact.released else 0
    lasting = _lasting(motion, pressed)
    delays = _best_delays(comparison.signal(lasting[..., 0]), comparison, pressed, step, within)
    misfit, delays, blurred = _with_delays(lasting, comparison, pressed, step, delays, within, prior)
    # Presses of unknown instants that seem farther from their motion than this many σ are simulated again.
    if pressed and misfit > 1.2:
        # Large motions are not quite additive.
        motion = simulated(contact.load_seconds + delays[1] - delays[0])
        misfit = min(misfit, _with_delays(motion, comparison, 0, step, delays, within, prior)[0])
    return misfit, information, blurred


def _best_delays(
    lasting: np.ndarray, comparison: _Comparison, pressed: int, step: float, within: float
) -> tuple[float, float]:
    """Return delays of the press's beginning, and of its end where that was observed, that fit best among a few [s].

    Motions count as additive: a press that ends is one that lasts, less one that begins when it ends.

    Args:
        lasting: the signal of a press that lasts, after every step since the time stamp of the beginning, shape [T].
        pressed: steps from there to the end's; 0 = no end was observed.
        step: time step [s].
        within: largest delay [s].
    """
    tried = within * DELAYS
    since = comparison.times - tried[:, None]
    simulated = between_steps(lasting, step, since.ravel())[0].reshape(-1, 1, len(comparison.times))
    residual = simulated - comparison.observed
    if pressed:
        residual = residual - between_steps(lasting, step, (since - pressed * step).ravel())[0].reshape(since.shape)
    first, last = np.unravel_index(np.argmin(np.square(residual).sum(axis=2)), residual.shape[:2])
    return float(tried[first]), float(tried[last]) if pressed else 0.0


def _with_delays(
    lasting: np.ndarray,
    comparison: _Comparison,
    pressed: int,
    step: float,
    delays: tuple[float, float],
    within: float,
    prior: np.ndarray,
) -> tuple[float, tuple[float, float], bool]:
    """Refine the delays from a start; return the RMS residual [σ], the delays [s], and whether the dent is blurred.

    Args:
        lasting: displacements under a press that lasts, and their derivatives by φ, shape [T, M, 3, 4].
        comparison, pressed, step, within: as in `_best_delays`.
        delays: the start [s].
        prior: precision of φ, shape [3, 3].
    """
    found, count = [], 2 if pressed else 1
    whole = np.zeros((count + len(prior), count + len(prior)))
    whole[:count, :count], whole[count:, count:] = np.eye(count) / within**2, prior
    for _ in range(5):
        moved, rate = between_steps(lasting, step, comparison.compared_times - delays[0])
        rates = [-rate[..., :1]]
        if pressed:
            ended, rate = between_steps(lasting, step, comparison.compared_times - pressed * step - delays[1])
            moved, rates = moved - ended, [*rates, rate[..., :1]]
        residual, slopes = comparison.residual(moved[..., 0], np.concatenate([*rates, moved[..., 1:]], axis=-1))
        later = _nearest(residual, slopes, whole)
        # The iteration ends once delays change by less than this; they change by half of the largest delay at most.
        settled = np.abs(later[:count]).max() < 0.05 * within
        first, last = np.append(np.clip(later[:count], -0.5 * within, 0.5 * within), 0.0)[:2]
        later_delays = delays[0] + float(first), delays[1] + float(last)
        if settled:
            found.append((_rms(residual + slopes @ later), later_delays))
            break
        found.append((_rms(residual + slopes[:, count:] @ later[count:]), delays))
        delays = later_delays
    return *min(found), _blurred(residual, slopes, comparison.blurs, whole)


def _blurred(residual: np.ndarray, slopes: np.ndarray, blurs: np.ndarray, prior: np.ndarray) -> bool:
    """Return whether blurs of the depth [L, K] explain the residual beyond noise, and beyond chance for K
    parameters."""
    count, squares = blurs.shape[1], []
    for part, precision in (slopes, prior), (np.hstack([slopes, blurs]), block_diag(prior, np.eye(count))):
        change = _nearest(residual, part, precision)
        squares.append(np.square(residual + part @ change).sum() + change @ precision @ change)
    return bool(squares[0] > len(residual) and squares[0] - squares[1] > count * math.log(len(residual)))


def _nearest(residual: np.ndarray, slopes: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Return the change of D parameters with prior precision [D, D] that makes residuals [L] least, to first order,
    shape [D]."""
    return -np.linalg.solve(slopes.T @ slopes + prior, slopes.T @ residual)


def _lasting(path: np.ndarray, pressed: int) -> np.ndarray:
    """Return a path [T, ...] as if the press had not ended after `pressed` steps; 0 = it didn't end."""
    lasting = path.copy()
    for first in range(pressed, len(path), pressed) if pressed else ():
        lasting[first : first + pressed] += lasting[first - pressed : first][: len(path) - first]
    return lasting


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.square(values).mean())) if values.size else 0.0
