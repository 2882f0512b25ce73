"""Likelihood of an observed motion under the simulator: residual, Jacobian, information.

φ = (log k_s, log k_d, log |F|), with F pressing.
The noise is normal, so -log p(d|φ) = ½ Σ r² with the residual r = (Φ(φ) - d)/σ (Bini 2026, equation 14, with σ).
"""

import numpy as np

from palpate.physics.load import Press
from palpate.physics.mechanics import Mechanics, theta_of
from palpate.physics.mesh import Mesh
from palpate.physics.msd.simulation import simulate_tangent
from palpate.physics.observation import Linearised, Observation


class LeastSquares:
    """Base of nonlinear least-squares problems with D parameters; subclasses implement `_linearise`."""

    _known: tuple[np.ndarray, Linearised] | None = None

    def linearise(self, logs: np.ndarray) -> Linearised:
        """Residual and its derivatives at some parameters [D]; the last ones are remembered."""
        known = self._known  # once: another thread may put its own there
        if known is None or not np.array_equal(logs, known[0]):
            known = self._known = np.array(logs), self._linearise(np.asarray(logs, np.float64))
        return known[1]

    def residual(self, logs: np.ndarray) -> np.ndarray:
        """Residual in standard deviations, shape [K]."""
        return self.linearise(logs).residual

    def jacobian(self, logs: np.ndarray) -> np.ndarray:
        """Derivatives of the residual by the parameters, shape [K, D]."""
        return self.linearise(logs).jacobian

    def information(self, logs: np.ndarray) -> np.ndarray:
        """Fisher information at some parameters, shape [D, D]."""
        return self.linearise(logs).information

    def _linearise(self, logs: np.ndarray) -> Linearised:
        raise NotImplementedError


class Likelihood(LeastSquares):
    """The simulator against an observation.

    Args:
        mesh: tissue at rest.
        load: press on the mesh, over the instants of the observation at least.
        observation: observed motion; instants are compared at the nearest step.
        mechanics: constants of the simulator.
        dtype: float32 or float64, the precision of the simulation.

    Raises:
        ValueError: no instants, or some outside the load's steps; noise that is no positive number where a point was
            seen.
    """

    def __init__(
        self, mesh: Mesh, load: Press, observation: Observation, mechanics: Mechanics, dtype: type = np.float64
    ) -> None:
        self.mesh, self.observation, self.mechanics, self.dtype = mesh, observation, mechanics, dtype
        self.steps = observation.steps(mechanics.time_step)
        """Index into the trajectory of every instant, shape [N]."""
        if len(self.steps) == 0 or self.steps.min() < 0 or self.steps.max() >= load.steps:
            raise ValueError(f"the observation has instants outside the load's {load.steps} steps, or none at all.")
        self.load = load.until(int(self.steps.max()) + 1)
        seen = np.isfinite(observation.displacement)
        if not (np.broadcast_to(observation.noise, seen.shape)[seen] > 0).all():
            raise ValueError("noise of a seen point isn't a positive number; give a standard deviation above 0.")

    def theta(self, logs: np.ndarray) -> np.ndarray:
        """θ = [k_s, k_d, F] at φ, shape [3]."""
        return theta_of(logs[:3])

    def _linearise(self, logs: np.ndarray) -> Linearised:
        """Exact; without derivatives where the motion is so chaotic that rounding decides them."""
        what = self.theta(logs), self.mesh, self.load, self.mechanics
        path, slopes = simulate_tangent(*what, watch=self.observation.vertices, dtype=self.dtype)
        return self.observation.linearise(path[self.steps], slopes[self.steps])
