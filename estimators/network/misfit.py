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

from data.contact.film import REACH, DentFilm
from data.contact.interaction import Interaction
from data.contact.patches import Patches
from estimators.direct.field import MOVED, WALL
from estimators.direct.motion import between_steps
from estimators.direct.problem import DELAYS
from physics.identifiability import fisher_information, log_jacobian
from physics.load import held
from physics.mechanics import Mechanics, theta_of
from physics.msd.simulation import is_chaotic, simulate, simulate_sensitivities

DOUBTFUL = 1.2
"""Presses of unknown instants that seem farther from their motion than this many σ are simulated anew."""
NEAR = 2
"""Pixels up to so many rows and columns from the contact are compared."""
LOOKS = 3
"""Delays are found to first order, so often."""
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
        self._shown, self.observed = own[clear], self._change[:, clear].mean(axis=1)
        frames = np.unique(np.linspace(0, len(film.times) - 1, MOST_FRAMES).round().astype(int))
        self.few, self._change = film.times[frames], self._change[frames]

    def signal(self, path: np.ndarray) -> np.ndarray:
        return self._patches.sunk(path[:, 1:])[:, self._shown].mean(axis=1)

    def left(self, moved: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        patches, moved, rates = self._patches, moved[:, 1:], rates[:, 1:]
        covering = patches.covering(moved)
        change = patches.shown(patches.sunk(moved), covering)
        left = change - self._change
        used = np.isfinite(left) & (np.abs(change) > MOVED * self._noise).any(axis=0)
        sigma = np.hypot(self._noise, WALL * patches.steepness(moved))[used]
        slopes = patches.shown(patches.sunk_slopes(moved, rates), covering)[used]
        return left[used] / sigma, slopes / sigma[:, None]


def _seen_of(contact: Interaction) -> _Seen:
    """What tells how well a contact's motion is explained."""
    film = contact.film
    if film is not None and len(film.times) and film.is_finer_than(contact.mesh.grid_shape):
        found = _Dent(contact, film)
        if np.isfinite(found.observed).all():
            return found
    return _Point(contact)


def compared(contact: Interaction, mechanics: Mechanics, logs: np.ndarray, within: float) -> tuple[float, np.ndarray]:
    """How far a contact's motion lies from the simulated one, and what it tells of φ if its instants are known.

    Args:
        contact: as it was seen.
        mechanics: of the simulation.
        logs: φ, shape [3].
        within: the press began, and ended, at most so long before or after the time stamps [s]; the delays are those
            that explain the motion best.

    Returns:
        Root mean square of what is left unexplained [σ], and the Fisher information [3, 3] of the contact's motion.
    """
    step, theta, seen = mechanics.time_step, theta_of(logs), _seen_of(contact)
    instants = contact.observation.steps(step)
    steps = max(int(instants.max()), round(seen.times[-1] / step) - 1) + 1 + math.ceil(within / step)
    loaded = contact.load_seconds if contact.released else math.inf
    press = dataclasses.replace(contact.load, factor=held(loaded / step, steps))
    path, slopes = simulate_sensitivities(theta, contact.mesh, press, mechanics, watch=seen.vertices, dtype=np.float32)
    slopes = log_jacobian(slopes[:, 0].astype(np.float64), theta)
    if is_chaotic(path[:, 0], slopes):
        slopes = np.zeros_like(slopes)
    information = fisher_information(slopes[instants].reshape(-1, len(logs)), contact.noise)
    path = path.astype(np.float64)
    if not within:
        return _misfit(seen, path[np.rint(seen.few / step).astype(np.int64) - 1]), information
    pressed = max(1, round(contact.load_seconds / step)) if contact.released else 0
    delays = _best_delays(_lasting(seen.signal(path), pressed), seen, pressed, step, within)
    misfit, delays = _with_delays(_lasting(path, pressed), seen, pressed, step, delays, within)
    if pressed and misfit > DOUBTFUL:
        # Large motions do not quite add up.
        loaded = contact.load_seconds + delays[1] - delays[0]
        press = dataclasses.replace(contact.load, factor=held(loaded / step, steps))
        path = simulate(theta, contact.mesh, press, mechanics, watch=seen.vertices).astype(np.float64)
        misfit = min(misfit, _with_delays(path, seen, 0, step, delays, within)[0])
    return misfit, information


def _misfit(seen: _Seen, moved: np.ndarray) -> float:
    """Root mean square of what displacements [K, M, 3] leave unexplained [σ]."""
    return _rms(seen.left(moved, np.zeros((*moved.shape, 0)))[0])


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
    lasting: np.ndarray, seen: _Seen, pressed: int, step: float, delays: tuple[float, float], within: float
) -> tuple[float, tuple[float, float]]:
    """Root mean square of what is left unexplained near some delays [σ], and these where they fit best [s].

    Args:
        lasting: displacements under a press that lasts, after every step, shape [T, M, 3].
        others: as of `_best_delays`.
    """
    found = []
    for _ in range(LOOKS):
        moved, rate = between_steps(lasting, step, seen.few - delays[0])
        rates = -rate[..., None]
        if pressed:
            ended, rate = between_steps(lasting, step, seen.few - pressed * step - delays[1])
            moved, rates = moved - ended, np.stack([rates[..., 0], rate], axis=-1)
        left, slopes = seen.left(moved, rates)
        found.append((_rms(left), delays))
        information = slopes.T @ slopes + np.eye(slopes.shape[1]) / within**2
        later = -np.linalg.solve(information, slopes.T @ left)
        reach = within * (DELAYS[1] - DELAYS[0])
        later = np.append(np.clip(later, -reach, reach), 0.0)
        delays = delays[0] + float(later[0]), delays[1] + float(later[1])
    return min(found)


def _lasting(path: np.ndarray, pressed: int) -> np.ndarray:
    """A path [T, ...] as if the press, which ended after some steps, had lasted; 0 = it did."""
    lasting = path.copy()
    for first in range(pressed, len(path), pressed) if pressed else ():
        lasting[first : first + pressed] += lasting[first - pressed : first][: len(path) - first]
    return lasting


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.square(values).mean())) if values.size else 0.0
