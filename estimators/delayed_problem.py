"""A contact whose press began at an unknown instant: its delay is fitted beside θ.

A camera knows the beginning of a press to a frame only, and a few milliseconds look like other tissue. So the motion
Φ(φ; t - δ) is compared with what was seen, with the delay δ as a fourth parameter; what remains known of θ is what the
delay can't explain.
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

DELAYS = 17
"""Delays that are tried for every start, evenly spread."""


class DelayedProblem(ContactProblem):
    """Residuals and their exact derivatives by (log k_s, log k_d, log |F|, δ), δ in seconds after the time stamp.

    Before the press begins the tissue is at rest. The whole press is delayed, its release as well.

    Args:
        case, mechanics, noise: as of `ContactProblem`.
        within: the press began at most so long before or after the time stamp [s].
    """

    def __init__(self, case: ContactCase, mechanics: Mechanics, noise: float, within: float) -> None:
        super().__init__(case, mechanics, noise)
        self.within = within
        self.times = (case.steps + 1) * mechanics.time_step
        """Of the observations since the time stamp [s], shape [M]."""
        released = case.load_steps < self.mechanics.steps
        steps = self.mechanics.steps + math.ceil(within / mechanics.time_step)
        self.mechanics = dataclasses.replace(self.mechanics, steps=steps)
        if not released:  # a press that was not seen to end goes on
            self.load_steps = steps

    @staticmethod
    def theta(logs: np.ndarray) -> np.ndarray:
        """θ of the four parameters, with F pressing."""
        return ContactProblem.theta(logs[:3])

    def best_starts(self, candidates: np.ndarray, paths: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Starts as of `ContactProblem`, each candidate [C, 4] at the delay that suits it best."""
        delays = np.linspace(-self.within, self.within, DELAYS)
        since = np.maximum(self.times - delays[:, None], 0)
        settled, moved = candidates.copy(), np.empty_like(paths)
        for index, candidate in enumerate(candidates):
            tried = self._coarse_curve(candidate)(since)
            along = np.einsum("tmd,md->t", tried, self.observed)
            explained = np.square(np.maximum(along, 0)) / np.maximum(np.square(tried).sum(axis=(1, 2)), 1e-30)
            best = int(np.argmax(explained))
            settled[index, 3], moved[index] = delays[best], tried[best]
        return super().best_starts(settled, moved, low, high)

    def coarse_paths(self, logs: np.ndarray) -> np.ndarray:
        """Motion at the observations for every set of four parameters [n, 4], coarse in time, shape [n, M, 3]."""
        paths = [self._coarse_curve(item)(np.maximum(self.times - item[3], 0)) for item in logs]
        return np.array(paths, np.float64).reshape(-1, len(self.times), 3)

    def _coarse_curve(self, values: np.ndarray) -> CubicSpline:
        """Motion since the beginning of the press, a function of time to [..., 3]."""
        coarse = max(1, round(COARSE_STEP / self.mechanics.time_step))
        time_step, steps = coarse * self.mechanics.time_step, -(-self.mechanics.steps // coarse)
        mechanics = dataclasses.replace(self.mechanics, time_step=time_step, steps=steps, window_error=1e-3)
        case, load_steps = self.case, min(round(self.load_steps / coarse), steps)
        path = simulate(self.theta(values), case.mesh, case.vertex, case.direction, mechanics, load_steps=load_steps)
        return _from_rest(path, time_step)

    def _evaluate(self, logs: np.ndarray) -> None:
        if self._at is not None and np.array_equal(logs, self._at):
            return
        theta, case = self.theta(logs), self.case
        arguments = theta, case.mesh, case.vertex, case.direction, self.mechanics
        path, slopes = simulate_sensitivities(*arguments, load_steps=self.load_steps, dtype=np.float64)
        both = np.concatenate([path[..., None], log_jacobian(slopes, theta)], axis=-1)
        curve, since = _from_rest(both, self.mechanics.time_step), self.times - logs[3]
        found = curve(np.maximum(since, 0))
        velocity = curve(np.maximum(since, 0), 1)[..., :1] * (since > 0)[:, None, None]
        self._at = logs.copy()
        self._residual = ((found[..., 0] - self.observed) / self.noise).ravel()
        self._jacobian = np.concatenate([found[..., 1:], -velocity], axis=-1).reshape(-1, 4) / self.noise


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
