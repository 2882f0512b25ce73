"""One observed contact as a least-squares problem: residuals, their exact derivatives, and where to start."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.stats.qmc import Sobol

from data.samples import ContactCase
from physics.identifiability import fisher_information, log_jacobian
from physics.mechanics import Mechanics
from physics.msd_kernel import simulate, simulate_sensitivities

CANDIDATES = 128
"""Points of a Sobol sequence over the box among which the starts are chosen: an under-damped response has many local
optima, one for every number of swings."""
STARTS = 6
"""Fits, begun at the candidates that explain the data best."""
APART = 0.1
"""Starts are farther apart than this share of the box, in stiffness or damping: neighbours end in the same optimum."""
COARSE_STEP = 0.005
"""Time step of simulations without derivatives [s]: off by up to 0.1 σ for the stiffest tissue."""


class ContactProblem:
    """Residuals and their exact derivatives by φ, each in units of the noise."""

    def __init__(self, case: ContactCase, mechanics: Mechanics, noise: float) -> None:
        self.case, self.noise = case, noise
        steps = int(case.steps.max()) + 1
        self.mechanics = dataclasses.replace(mechanics, steps=steps, load_steps=0)
        self.load_steps = min(case.load_steps, steps)
        self.observed = case.displacement.astype(np.float64)
        self._at: np.ndarray | None = None

    @staticmethod
    def theta(logs: np.ndarray) -> np.ndarray:
        """θ with F pressing."""
        return np.exp(logs) * (1.0, 1.0, -1.0)

    def delays(self, logs: np.ndarray) -> tuple[float, ...]:
        """Time from the stamps of the first frame in contact, and of the first one after it, to the true instants [s].

        None of either where it is no parameter.
        """
        return ()

    def candidates(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """φ evenly spread over the box, shape [CANDIDATES, 3] (or with further parameters)."""
        return low + Sobol(len(low), rng=0).random(CANDIDATES) * (high - low)

    def starts(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """φ of the candidates with the smallest misfit, shape [at most STARTS, 3]."""
        candidates = self.candidates(low, high)
        return self.best_starts(candidates, self.coarse_paths(candidates), low, high)

    def best_starts(self, candidates: np.ndarray, paths: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Starts among candidates [C, 3] whose motions [C, M, 3] are known.

        Displacement is about proportional to the force, so each candidate is tried with the force that suits it best.
        """
        fitting = np.einsum("cmd,md->c", paths, self.observed) / np.maximum(np.square(paths).sum(axis=(1, 2)), 1e-30)
        logs = candidates.copy()
        logs[:, 2] = np.clip(logs[:, 2] + np.log(np.maximum(fitting, 1e-9)), low[2], high[2])
        factors = np.exp(logs[:, 2] - candidates[:, 2])
        misfits = np.square(factors[:, None, None] * paths - self.observed).sum(axis=(1, 2))
        chosen: list[int] = []
        for index in np.argsort(misfits):
            distances = np.abs(logs[chosen] - logs[index])[:, :2] / (high - low)[:2]
            if (distances.max(axis=1, initial=0) > APART).all() or not chosen:
                chosen.append(int(index))
            if len(chosen) == STARTS:
                break
        return logs[chosen]

    def coarse_paths(self, logs: np.ndarray) -> np.ndarray:
        """Motion at the observations for every φ [n, 3], with a coarse time step, shape [n, M, 3]."""
        case = self.case
        coarse = max(1, round(COARSE_STEP / self.mechanics.time_step))
        if ((case.steps + 1) % coarse).any():
            coarse = 1
        steps = -(-self.mechanics.steps // coarse)
        mechanics = dataclasses.replace(
            self.mechanics, time_step=coarse * self.mechanics.time_step, steps=steps, window_error=1e-3
        )
        seen, load_steps = (case.steps + 1) // coarse - 1, min(round(self.load_steps / coarse), steps)
        arguments = case.mesh, case.vertex, case.direction, mechanics
        paths = [simulate(self.theta(item), *arguments, load_steps=load_steps)[seen] for item in logs]
        return np.array(paths, np.float64).reshape(-1, len(seen), 3)

    def path(self, logs: np.ndarray) -> np.ndarray:
        """Motion at the observations for one φ, with the problem's own time step, shape [M, 3]."""
        return self.residual(logs).reshape(-1, 3) * self.noise + self.observed

    def information(self, logs: np.ndarray) -> np.ndarray:
        """Fisher information at φ, shape [3, 3]."""
        return fisher_information(self.jacobian(logs), 1.0)

    def residual(self, logs: np.ndarray) -> np.ndarray:
        """(Φ - d)/σ, flattened."""
        self._evaluate(logs)
        return self._residual

    def jacobian(self, logs: np.ndarray) -> np.ndarray:
        """Its derivatives by φ."""
        self._evaluate(logs)
        return self._jacobian

    def _evaluate(self, logs: np.ndarray) -> None:
        if self._at is not None and np.array_equal(logs, self._at):
            return
        theta, case = self.theta(logs), self.case
        arguments = theta, case.mesh, case.vertex, case.direction, self.mechanics
        path, slopes = simulate_sensitivities(*arguments, load_steps=self.load_steps, dtype=np.float64)
        self._at = logs.copy()
        self._residual = ((path[case.steps] - self.observed) / self.noise).ravel()
        self._jacobian = (log_jacobian(slopes[case.steps], theta) / self.noise).reshape(-1, 3)
