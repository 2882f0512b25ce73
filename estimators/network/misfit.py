"""How far what was seen of a contact lies from the simulated motion, in standard deviations, by one rollout.

Where a pixel of the grid is one of the picture, the contact's own point tells. Where it is the mean of several, the
bottom of a dent, which is no wider, is not seen at its depth; there the pixels around it tell, each as the mean of what
it shows.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Protocol

import numpy as np
from scipy.special import gammainccinv

from data.contact.film import REACH, DentFilm
from data.contact.interaction import Interaction
from data.contact.patches import Patches
from estimators.direct.field import MOVED, WALL
from estimators.direct.motion import between_steps
from estimators.direct.problem import DELAYS
from physics.identifiability import fisher_information, log_jacobian
from physics.load import held
from physics.mechanics import Mechanics, theta_of
from physics.msd.simulation import is_chaotic, simulate_sensitivities

LARGEST_MISFIT = 1.5
"""A motion farther from the simulated one than this many σ is unlike what the network was trained on, and its own
covariance means nothing: that of a noise as large as the misfit, within the box, is added."""
CHANCE = 3.5e-4
"""Noise alone takes 25 observations so far away so rarely; fewer may lie farther."""
DOUBTFUL = 1.2
"""Presses of unknown instants that seem farther from their motion than this many σ are simulated anew."""
NEAR = 2
"""Pixels up to so many rows and columns from the contact are compared."""
LOOKS = 5
"""Delays are found to first order, at most so often."""
SETTLED = 0.05
"""No more often once they change by less than this, in units of the largest."""
FARTHEST = 0.5
"""Farthest change that is believed at once, in units of the largest delay."""
MOST_FRAMES = 8
"""In so many frames, evenly chosen: finding out what pixels show takes longer than the rollout."""


class _Seen(Protocol):
    """What the simulation is compared with; M vertices, N instants, at K of which all is compared."""

    vertices: np.ndarray
    """To be simulated, the contact's first, shape [M]."""
    times: np.ndarray
    """Instants after the onset, shape [N] [s]."""
    few: np.ndarray
    """Those at which all is compared, shape [K] [s]."""
    observed: np.ndarray
    """One number of what was seen, by which delays are found, shape [N] [scene units]."""

    def signal(self, path: np.ndarray) -> np.ndarray:
        """The same number of simulated displacements [T, M, 3], shape [T]."""
        ...

    def left(self, moved: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What displacements at the few instants [K, M, 3] leave unexplained, [L] [σ].

        And how it changes where these change at some rates [K, M, 3, D], shape [L, D].
        """
        ...


class _Point:
    """The followed point, along the force."""

    def __init__(self, contact: Interaction) -> None:
        self.vertices, self.times, self.observed = np.array([contact.vertex]), contact.observation.times, contact.along
        self.few = self.times
        self._direction, self._noise = np.asarray(contact.direction, np.float64), contact.noise

    def signal(self, path: np.ndarray) -> np.ndarray:
        return path[:, 0] @ self._direction

    def left(self, moved: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        changes = np.einsum("nid,i->nd", rates[:, 0], self._direction)
        return (self.signal(moved) - self.observed) / self._noise, changes / self._noise


class _Dent:
    """The pixels around the contact that move."""

    def __init__(self, contact: Interaction, film: DentFilm) -> None:
        patches = Patches(contact.mesh, contact.vertex, film.size, NEAR)
        self._patches, self.times, self._noise = patches, film.times, film.noise.total
        near = np.s_[REACH - NEAR : REACH + NEAR + 1]
        self._change = film.change[:, near, near].reshape(len(film.times), -1).astype(np.float64)
        self.vertices = np.append(contact.vertex, patches.vertices)
        # Pixels that are never hidden; taken together they show the same tissue all the time, more or less.
        own = patches.own()
        clear = np.isfinite(self._change).all(axis=0) & (own >= 0)
        self._shown, self.observed = own[clear], np.full(len(film.times), np.nan)
        if clear.any():
            self.observed = self._change[:, clear].mean(axis=1)
        frames = np.unique(np.linspace(0, len(film.times) - 1, MOST_FRAMES).round().astype(int))
        self.few, self._change = film.times[frames], self._change[frames]

    def signal(self, path: np.ndarray) -> np.ndarray:
        return self._patches.sunk(path[:, 1 + self._shown], self._shown).mean(axis=1)

    def left(self, moved: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        patches, moved, rates = self._patches, moved[:, 1:], rates[:, 1:]
        covering = patches.covering(moved)
        both = np.concatenate([patches.sunk(moved)[..., None], patches.sunk_slopes(moved, rates)], axis=-1)
        shown = patches.shown(both, covering)
        change = shown[..., 0]
        left = change - self._change
        used = np.isfinite(left) & (np.abs(change) > MOVED * self._noise).any(axis=0)
        sigma = np.hypot(self._noise, WALL * patches.steepness(moved))[used]
        return left[used] / sigma, shown[used, 1:] / sigma[:, None]


def _seen_of(contact: Interaction) -> _Seen:
    """What tells how well a contact's motion is explained."""
    film = contact.film
    if film is not None and len(film.times) and film.is_finer_than(contact.mesh.grid_shape):
        found = _Dent(contact, film)
        if np.isfinite(found.observed).all():
            return found
    return _Point(contact)


def largest_misfit(count: int) -> float:
    """Largest root mean square [σ] of so many observations that noise may explain."""
    return max(LARGEST_MISFIT, math.sqrt(2 * float(gammainccinv(count / 2, CHANCE)) / count))


def compared(
    contact: Interaction, mechanics: Mechanics, logs: np.ndarray, covariance: np.ndarray, within: float
) -> tuple[float, np.ndarray]:
    """How far a contact's motion lies from the simulated one, and what it tells of φ if its instants are known.

    Args:
        contact: as it was seen.
        mechanics: of the simulation.
        logs, covariance: posterior of φ, shapes [3] and [3, 3]; the motion is compared with the nearest that it allows.
        within: the press began, and ended, at most so long before or after the time stamps [s]; the delays are those
            that explain the motion best.

    Returns:
        Root mean square of what is left unexplained [σ], and the Fisher information [3, 3] of the contact's motion.
    """
    step, theta, seen = mechanics.time_step, theta_of(logs), _seen_of(contact)
    instants = contact.observation.steps(step)
    steps = max(int(instants.max()), round(seen.times[-1] / step) - 1) + 1 + math.ceil(within / step)
    loaded = contact.load_seconds if contact.released else math.inf

    def simulated(seconds: float) -> np.ndarray:
        """Displacements and their derivatives by φ under a press that lasts so long, shape [T, M, 3, 4]."""
        press = dataclasses.replace(contact.load, factor=held(seconds / step, steps))
        path, slopes = simulate_sensitivities(theta, contact.mesh, press, mechanics, watch=seen.vertices)
        slopes = log_jacobian(slopes, theta)
        if is_chaotic(path, slopes):
            slopes = np.zeros_like(slopes)
        return np.concatenate([path[..., None], slopes], axis=-1)

    motion, prior = simulated(loaded), np.linalg.inv(covariance)
    information = fisher_information(motion[instants, 0, :, 1:].reshape(-1, len(logs)), contact.noise)
    if not within:
        at = motion[np.rint(seen.few / step).astype(np.int64) - 1]
        left, slopes = seen.left(at[..., 0], at[..., 1:])
        return _rms(left + slopes @ _nearest(left, slopes, prior)), information
    pressed = max(1, round(contact.load_seconds / step)) if contact.released else 0
    lasting = _lasting(motion, pressed)
    delays = _best_delays(seen.signal(lasting[..., 0]), seen, pressed, step, within)
    misfit, delays = _with_delays(lasting, seen, pressed, step, delays, within, prior)
    if pressed and misfit > DOUBTFUL:
        # Large motions do not quite add up.
        motion = simulated(contact.load_seconds + delays[1] - delays[0])
        misfit = min(misfit, _with_delays(motion, seen, 0, step, delays, within, prior)[0])
    return misfit, information


def _best_delays(lasting: np.ndarray, seen: _Seen, pressed: int, step: float, within: float) -> tuple[float, float]:
    """Delays of the press's beginning, and of its end where that was seen, that fit best among a few [s].

    As if motions added up: a press that ends is one that lasts, less one that begins when it ends.

    Args:
        lasting: the signal of a press that lasts, after every step since the time stamp of the beginning, shape [T].
        pressed: steps from there to the end's; 0 = not seen.
        step: of time [s].
        within: largest delay [s].
    """
    tried = within * DELAYS
    since = seen.times - tried[:, None]
    left, ends = between_steps(lasting, step, since.ravel())[0].reshape(-1, 1, len(seen.times)) - seen.observed, tried
    if pressed:
        left = left - between_steps(lasting, step, (since - pressed * step).ravel())[0].reshape(since.shape)
    first, last = np.unravel_index(np.argmin(np.square(left).sum(axis=2)), left.shape[:2])
    return float(tried[first]), float(ends[last]) if pressed else 0.0


def _with_delays(
    lasting: np.ndarray,
    seen: _Seen,
    pressed: int,
    step: float,
    delays: tuple[float, float],
    within: float,
    prior: np.ndarray,
) -> tuple[float, tuple[float, float]]:
    """Root mean square of what is left unexplained near some delays [σ], and these where they fit best [s].

    Args:
        lasting: displacements under a press that lasts, and their derivatives by φ, shape [T, M, 3, 4].
        prior: precision of φ, shape [3, 3].
        others: as of `_best_delays`.
    """
    found, count = [], 2 if pressed else 1
    whole = np.zeros((count + len(prior), count + len(prior)))
    whole[:count, :count], whole[count:, count:] = np.eye(count) / within**2, prior
    for _ in range(LOOKS):
        moved, rate = between_steps(lasting, step, seen.few - delays[0])
        rates = [-rate[..., :1]]
        if pressed:
            ended, rate = between_steps(lasting, step, seen.few - pressed * step - delays[1])
            moved, rates = moved - ended, [*rates, rate[..., :1]]
        left, slopes = seen.left(moved[..., 0], np.concatenate([*rates, moved[..., 1:]], axis=-1))
        later = _nearest(left, slopes, whole)
        settled = np.abs(later[:count]).max() < SETTLED * within
        first, last = np.append(np.clip(later[:count], -FARTHEST * within, FARTHEST * within), 0.0)[:2]
        later_delays = delays[0] + float(first), delays[1] + float(last)
        if settled:
            found.append((_rms(left + slopes @ later), later_delays))
            break
        found.append((_rms(left + slopes[:, count:] @ later[count:]), delays))
        delays = later_delays
    return min(found)


def _nearest(left: np.ndarray, slopes: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Change of D parameters about which something is known [D, D] that leaves least of residuals [L], to 1st order."""
    return -np.linalg.solve(slopes.T @ slopes + prior, slopes.T @ left)


def _lasting(path: np.ndarray, pressed: int) -> np.ndarray:
    """A path [T, ...] as if the press, which ended after some steps, had lasted; 0 = it did."""
    lasting = path.copy()
    for first in range(pressed, len(path), pressed) if pressed else ():
        lasting[first : first + pressed] += lasting[first - pressed : first][: len(path) - first]
    return lasting


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.square(values).mean())) if values.size else 0.0
