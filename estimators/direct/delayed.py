"""A contact whose press began, and ended, at unknown instants: two delays are fitted beside θ.

A camera knows the beginning and the end of a press to a frame only, and a few milliseconds look like other tissue. So
the motion is compared with what was seen with two delays as further parameters, independent of each other; what is
known of θ is what they can't explain.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from scipy.interpolate import CubicSpline

from data.contact.interaction import Interaction
from estimators.direct.problem import ContactProblem
from physics.identifiability import log_jacobian
from physics.likelihood import Linearised
from physics.load import Press, held
from physics.mechanics import Mechanics
from physics.msd.simulation import simulate, simulate_sensitivities

DELAYS = np.linspace(-1, 1, 17)
"""Delays that are tried for every start."""
LATER = 0.5
"""Change of the load's duration whose effect gives the derivative by it [time steps]."""


class DelayedProblem(ContactProblem):
    """Residuals and their derivatives by (log k_s, log k_d, log |F|) and the delays of the press.

    The delays, of the beginning and of the end, count from the time stamps that say so, in units of `within`: from -1
    to 1. That of the end is a parameter where it was seen. Before the press begins the tissue is at rest.

    Args:
        contact, mechanics, noise: as of `ContactProblem`.
        within: the press began, and ended, at most so long before or after the time stamp [s].
    """

    def __init__(self, contact: Interaction, mechanics: Mechanics, noise: float, within: float) -> None:
        super().__init__(contact, mechanics, noise)
        self.within = within
        self.times = (self.steps + 1) * mechanics.time_step
        """Of the observations since the time stamp [s], shape [N]."""
        self.longest = self.load.steps + math.ceil(within / mechanics.time_step)
        """Steps of the simulation: the press may have begun earlier."""

    def box(self, tissue: np.ndarray) -> np.ndarray:
        """Lower and upper ends of all parameters, shape [2, 5] (4 where the release was not seen).

        Args:
            tissue: those of φ, shape [2, 3].
        """
        return np.hstack([tissue, np.tile([[-1.0], [1.0]], 2 if self.contact.released else 1)])

    def best_starts(self, candidates: np.ndarray, paths: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Starts as of `ContactProblem`, each candidate [C, D] delayed as suits it best, its release alike."""
        since = np.maximum(self.times - self.within * DELAYS[:, None], 0)
        settled, moved = candidates.copy(), np.empty_like(paths)
        settled[:, 3:] = 0
        for index, candidate in enumerate(settled):
            tried = self._coarse_curve(candidate)(since)
            along = np.einsum("tmd,md->t", tried, self.moved)
            explained = np.square(np.maximum(along, 0)) / np.maximum(np.square(tried).sum(axis=(1, 2)), 1e-30)
            best = int(np.argmax(explained))
            candidate[3:], moved[index] = DELAYS[best], tried[best]
        return super().best_starts(settled, moved, low, high)

    def coarse_paths(self, logs: np.ndarray) -> np.ndarray:
        """Motion at the observations for all parameters [n, D], with a coarse time step, shape [n, N, 3]."""
        paths = [self._coarse_curve(item)(np.maximum(self.times - self.within * item[3], 0)) for item in logs]
        return np.array(paths, np.float64).reshape(-1, len(self.times), 3)

    def pressed(self, logs: np.ndarray, time_step: float, steps: int, longer: float = 0.0) -> Press:
        """The load of all parameters.

        Args:
            logs: all parameters.
            time_step, steps: of the simulation [s].
            longer: than the parameters say the load lasts [s].
        """
        loaded = math.inf
        if self.contact.released:
            loaded = self.contact.load_seconds + self.within * (logs[4] - logs[3]) + longer
        return dataclasses.replace(self.load, factor=held(loaded / time_step, steps))

    def _coarse_curve(self, logs: np.ndarray) -> CubicSpline:
        """Motion since the beginning of the press, a function of time to [..., 3]."""
        mechanics, coarse = self.coarse_mechanics(whole=False)
        load = self.pressed(logs, mechanics.time_step, -(-self.longest // coarse))
        return from_rest(simulate(self.theta(logs), self.mesh, load, mechanics), mechanics.time_step)

    def _linearise(self, logs: np.ndarray) -> Linearised:
        theta, mechanics, step = self.theta(logs), self.mechanics, self.mechanics.time_step
        load = self.pressed(logs, step, self.longest)
        path, slopes = simulate_sensitivities(theta, self.mesh, load, mechanics, dtype=np.float64)
        curves = [path[..., None], log_jacobian(slopes, theta)]
        if self.contact.released:
            longer = LATER * step
            load = self.pressed(logs, step, self.longest, longer)
            later = simulate(theta, self.mesh, load, mechanics, dtype=np.float64)
            curves.append((later - path)[..., None] / longer)
        curve = from_rest(np.concatenate(curves, axis=-1), step)
        since = self.times - self.within * logs[3]
        found = curve(np.maximum(since, 0))
        velocity = curve(np.maximum(since, 0), 1)[..., :1] * (since > 0)[:, None, None]
        # A later beginning moves all of the motion, and shortens the load.
        by_duration = found[..., 4:]
        delayed = -velocity - by_duration if self.contact.released else -velocity
        jacobian = np.concatenate([found[..., 1:4], self.within * delayed, self.within * by_duration], axis=-1)
        residual = (found[..., 0] - self.moved) / self.sigma
        return Linearised(residual.ravel(), jacobian.reshape(-1, len(logs)) / self.sigma)


def from_rest(values: np.ndarray, time_step: float) -> CubicSpline:
    """What is known after every step [T, ...], and is 0 before the first, as a function of time."""
    times = np.arange(len(values) + 1) * time_step
    return CubicSpline(times, np.concatenate([np.zeros_like(values[:1]), values]))


def about_tissue(information: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Information of (log k_s, log k_d, log |F|) alone, shape [3, 3], where other parameters are unknown.

    Args:
        information: of all parameters, those three first, shape [D, D].
        prior: of all parameters; only that of the others counts, shape [D, D].
    """
    others = information[3:, 3:] + prior[3:, 3:]
    return information[:3, :3] - information[:3, 3:] @ np.linalg.solve(others, information[3:, :3])
