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

from data.samples import ContactCase
from estimators.contact_problem import COARSE_STEP, ContactProblem
from physics.identifiability import log_jacobian
from physics.mechanics import Mechanics
from physics.msd_kernel import simulate, simulate_sensitivities

DELAYS = np.linspace(-1, 1, 17)
"""Delays that are tried for every start."""
LATER = 0.5
"""Change of the load's duration whose effect gives the derivative by it [time steps]."""


class DelayedProblem(ContactProblem):
    """Residuals and their derivatives by (log k_s, log k_d, log |F|) and the delays of the press.

    The delays, of the beginning and of the end, count from the time stamps that say so, in units of `within`: from -1
    to 1. That of the end is a parameter where it was seen. Before the press begins the tissue is at rest.

    Args:
        case, noise: as of `ContactProblem`.
        mechanics: the same; a load as long as its rollout was not seen to end.
        within: the press began, and ended, at most so long before or after the time stamp [s].
    """

    def __init__(self, case: ContactCase, mechanics: Mechanics, noise: float, within: float) -> None:
        super().__init__(case, mechanics, noise)
        self.within = within
        self.times = (case.steps + 1) * mechanics.time_step
        """Of the observations since the time stamp [s], shape [M]."""
        self.load = case.load_steps * mechanics.time_step
        """Time under load by the stamps [s]."""
        self.released = case.load_steps < mechanics.steps
        steps = self.mechanics.steps + math.ceil(within / mechanics.time_step)  # it may have begun earlier
        self.mechanics = dataclasses.replace(self.mechanics, steps=steps)

    @staticmethod
    def theta(logs: np.ndarray) -> np.ndarray:
        """θ of all parameters, with F pressing."""
        return ContactProblem.theta(logs[:3])

    def delays(self, logs: np.ndarray) -> tuple[float, ...]:
        return tuple(float(self.within * value) for value in logs[3:])

    def box(self, tissue: np.ndarray) -> np.ndarray:
        """Lower and upper ends of all parameters, shape [2, 5] (4 where the release was not seen).

        Args:
            tissue: those of φ, shape [2, 3].
        """
        return np.hstack([tissue, np.tile([[-1.0], [1.0]], 2 if self.released else 1)])

    def best_starts(self, candidates: np.ndarray, paths: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Starts as of `ContactProblem`, each candidate [C, D] delayed as suits it best, its release alike."""
        since = np.maximum(self.times - self.within * DELAYS[:, None], 0)
        settled, moved = candidates.copy(), np.empty_like(paths)
        settled[:, 3:] = 0
        for index, candidate in enumerate(settled):
            tried = self._coarse_curve(candidate)(since)
            along = np.einsum("tmd,md->t", tried, self.observed)
            explained = np.square(np.maximum(along, 0)) / np.maximum(np.square(tried).sum(axis=(1, 2)), 1e-30)
            best = int(np.argmax(explained))
            candidate[3:], moved[index] = DELAYS[best], tried[best]
        return super().best_starts(settled, moved, low, high)

    def coarse_paths(self, logs: np.ndarray) -> np.ndarray:
        """Motion at the observations for all parameters [n, D], with a coarse time step, shape [n, M, 3]."""
        paths = [self._coarse_curve(item)(np.maximum(self.times - self.within * item[3], 0)) for item in logs]
        return np.array(paths, np.float64).reshape(-1, len(self.times), 3)

    def _coarse_curve(self, values: np.ndarray) -> CubicSpline:
        """Motion since the beginning of the press, a function of time to [..., 3]."""
        coarse = max(1, round(COARSE_STEP / self.mechanics.time_step))
        time_step, steps = coarse * self.mechanics.time_step, -(-self.mechanics.steps // coarse)
        mechanics = dataclasses.replace(self.mechanics, time_step=time_step, steps=steps, window_error=1e-3)
        arguments = self.theta(values), self.case.mesh, self.case.vertex, self.case.direction, mechanics
        return _from_rest(simulate(*arguments, load=self._profile(values, mechanics)), time_step)

    def _profile(self, values: np.ndarray, mechanics: Mechanics, longer: float = 0.0) -> np.ndarray:
        """Share of every step that is under load, shape [T].

        Args:
            values: all parameters.
            mechanics: its steps are meant.
            longer: than the parameters say the load lasts [s].
        """
        if not self.released:
            return np.ones(mechanics.steps)
        return held_for(self.load + self.within * (values[4] - values[3]) + longer, mechanics)

    def _evaluate(self, logs: np.ndarray) -> None:
        if self._at is not None and np.array_equal(logs, self._at):
            return
        theta, case, mechanics = self.theta(logs), self.case, self.mechanics
        arguments = theta, case.mesh, case.vertex, case.direction, mechanics
        path, slopes = simulate_sensitivities(*arguments, load=self._profile(logs, mechanics), dtype=np.float64)
        curves = [path[..., None], log_jacobian(slopes, theta)]
        if self.released:
            longer = LATER * mechanics.time_step
            later = simulate(*arguments, load=self._profile(logs, mechanics, longer), dtype=np.float64)
            curves.append((later - path)[..., None] / longer)
        curve = _from_rest(np.concatenate(curves, axis=-1), mechanics.time_step)
        since = self.times - self.within * logs[3]
        found = curve(np.maximum(since, 0))
        velocity = curve(np.maximum(since, 0), 1)[..., :1] * (since > 0)[:, None, None]
        # A later beginning moves all of the motion, and shortens the load.
        by_duration = found[..., 4:]
        delayed = -velocity - by_duration if self.released else -velocity
        jacobian = np.concatenate([found[..., 1:4], self.within * delayed, self.within * by_duration], axis=-1)
        self._at = logs.copy()
        self._residual = ((found[..., 0] - self.observed) / self.noise).ravel()
        self._jacobian = jacobian.reshape(-1, len(logs)) / self.noise


def held_for(seconds: float, mechanics: Mechanics) -> np.ndarray:
    """Share of every step that is under a load which lasts so long, shape [T]."""
    return np.clip(seconds / mechanics.time_step - np.arange(mechanics.steps), 0, 1)


def _from_rest(values: np.ndarray, time_step: float) -> CubicSpline:
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
