"""Motion of the mesh's vertices under a press, by all parameters of a fit: θ, and the beginning and end of the press.

A camera knows the beginning and the end of a press to a frame only, and a few milliseconds look like other tissue.
Where the instants aren't known, two delays are parameters besides φ = (log k_s, log k_d, log |F|), independent of each
other. They count from the time stamps that say so, in units of `within`: from -1 to 1. That of the end is a parameter
where it was observed. Before the press begins the tissue is at rest.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import Self

import numpy as np

from palpate.data.contact.interaction import Interaction
from palpate.physics.load import Press, PressShape, held
from palpate.physics.mechanics import Mechanics, theta_of
from palpate.physics.msd.simulation import simulate, simulate_tangent

FITTED = Mechanics(time_step=0.0025, steps=400, scheme="dkd", window_error=1e-6)
"""The default integrator; its own error must lie below the noise: of second order, with half the paper's step."""
_OTHERS = np.array([[1.0, 0.0, 0.0, 0.0], [2.0, 2.0, 1.0, 1.0], [3.0, 3.0, 3.0, 2.0]])
"""Node triples: four nodes in a row, the three others of each one."""


class PressMotion:
    """Displacements of M vertices at N instants for any parameters, D = 3, 4 or 5.

    Args:
        contact: mesh and load.
        mechanics: of simulations with derivatives.
        vertices: of the mesh, shape [M].
        times: instants since the time stamp at which the press was observed to begin, shape [N] [s].
        within: the press began, and ended, at most so long before or after the time stamps [s]; 0 = at them.
    """

    starts = 3
    """Number of candidates from which the search of the parameters begins."""
    looks = 2
    """Number of times that the tissue in the pixels is decided anew at the best fit."""
    parts = 1
    """Places of a picture's pixels along an axis, in which they may show other tissue."""
    astray, uneven = 0.0, 0.0
    """Errors of the simulated dent, as in `DepthLikelihood`."""
    sampled = True
    """True if some hundred draws are enough to sample the posterior of the parameters."""

    def __init__(
        self, contact: Interaction, mechanics: Mechanics, vertices: np.ndarray, times: np.ndarray, within: float = 0.0
    ) -> None:
        self.mechanics, self.vertices = mechanics, vertices
        self.steps = np.rint(times / mechanics.time_step).astype(np.int64) - 1
        """Index into a trajectory that starts at the time stamp of the instants, shape [N]."""
        self.contact, self.times, self.within = contact, (self.steps + 1) * mechanics.time_step, within
        self.longest = int(self.steps.max()) + 1 + math.ceil(within / mechanics.time_step)
        """Steps of a simulation: the press may have begun earlier."""

    @property
    def delays(self) -> slice:
        """Slice of the parameters that are delays: none, that of the beginning, or both."""
        return slice(3, 3 + (1 + self.contact.released if self.within else 0))

    def loaded(self, logs: np.ndarray, longer: float = 0.0) -> float:
        """Return the time under load for all parameters [D], and `longer`; infinite where no release was observed
        [s]."""
        if not self.contact.released:
            return math.inf
        delayed = self.within * (logs[4] - logs[3]) if self.within else 0.0
        return self.contact.load_seconds + delayed + longer

    def since(self, logs: np.ndarray) -> np.ndarray:
        """Return the instants since the beginning of the press, shape [N] [s]."""
        return self.times - (self.within * logs[3] if self.within else 0.0)

    def seen(self, curves: Sequence[np.ndarray], step: float, logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return displacements at the instants [N, …], and their derivatives by tissue's parameters and the delays [N,
        …, D].

        Args:
            curves: displacements after every step, their derivatives by tissue's parameters, and by the load's duration
                where that is unknown, shape [T, …, D'] each.
            step: [s].
            logs: all parameters.
        """
        since = self.since(logs)
        (found, rate), (by_tissue, _), *others = (between_steps(curve, step, since) for curve in curves)
        if not self.within:
            return found[..., 0], by_tissue
        # A later beginning moves all of the motion, and shortens the load.
        delayed = -rate * (since > 0)[:, None, None, None]
        if not self.contact.released:
            return found[..., 0], np.concatenate([by_tissue, self.within * delayed], axis=-1)
        ((by_duration, _),) = others
        parts = [by_tissue, self.within * (delayed - by_duration), self.within * by_duration]
        return found[..., 0], np.concatenate(parts, axis=-1)

    @property
    def centred(self) -> np.ndarray:
        """Indices of the parameters that every start takes from the middle of their range, where most are near."""
        return np.arange(self.delays.start, self.delays.stop)

    def box(self, tissue: np.ndarray) -> np.ndarray:
        """Return the lower and upper ends of all parameters, shape [2, D], from those of φ [2, 3]."""
        return np.hstack([tissue, np.tile([[-1.0], [1.0]], self.delays.stop - 3)])

    def theta(self, logs: np.ndarray) -> np.ndarray:
        """Return θ = [k_s, k_d, F], shape [3]."""
        return theta_of(logs[:3])

    def shape(self, logs: np.ndarray) -> PressShape | None:
        """Return the patch, direction and course of the force of all parameters [D]; None = a step on the contact
        vertex."""
        return None

    def load(self, logs: np.ndarray, time_step: float, steps: int, longer: float = 0.0) -> Press:
        """Return the load of all parameters.

        Args:
            logs: all parameters, shape [D].
            time_step, steps: of the simulation [s].
            longer: than the parameters say the load lasts [s].
        """
        return dataclasses.replace(self.contact.load, factor=held(self.loaded(logs, longer) / time_step, steps))

    def at(self, logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return displacements [N, M, 3] and their derivatives by all parameters [N, M, 3, D], in double precision.

        Exact by φ; by the delays of a press whose release was observed they are differences from then on, good to 5 %.
        Without derivatives where the motion is so chaotic that rounding decides them.
        """
        step, load = self.mechanics.time_step, self.load(logs, self.mechanics.time_step, self.longest)
        what = self.theta(logs), self.contact.mesh, load, self.mechanics
        path, slopes = simulate_tangent(*what, watch=self.vertices, dtype=np.float64)
        others = self._others(logs)
        if not self.within:
            return path[self.steps], np.concatenate([slopes[self.steps], others], axis=-1)
        curves = [path[..., None], slopes]
        if self.contact.released:
            # Change of the load's duration whose effect gives the derivative by it [time steps].
            longer = 0.5 * step
            later = self._path(logs, self.mechanics, self.longest, np.float64, longer)
            curves.append((later - path)[..., None] / longer)
        found, slopes = self.seen(curves, step, logs)
        return found, np.concatenate([slopes, others], axis=-1)

    def _others(self, logs: np.ndarray) -> np.ndarray:
        """Return derivatives of the displacements by all parameters besides φ and the delays, shape [N, M, 3, D']."""
        return np.empty((len(self.steps), len(self.vertices), 3, 0))

    def finer(self, logs: np.ndarray) -> np.ndarray:
        """Return the displacements with a quarter of the time step, shape [N, M, 3]: what the steps' own error is."""
        mechanics = dataclasses.replace(self.mechanics, time_step=self.mechanics.time_step / 4)
        path = self._path(logs, mechanics, 4 * self.longest, np.float64)
        return self._shown(path, 4 * (self.steps + 1), mechanics, logs)

    def coarse(self, logs: np.ndarray) -> np.ndarray:
        """Return the displacements with a coarse time step and in single precision, shape [N, M, 3]."""
        path, ratio = self.coarse_path(logs)
        return self._shown(path, (self.steps + 1) // ratio, self.coarse_mechanics()[0], logs)

    def quick(self, logs: np.ndarray) -> np.ndarray:
        """Return the displacements in single precision and a wider window, with the time step of `at`, shape [N, M,
        3]."""
        # Window error of simulations that a whole dent's posterior is sampled with.
        mechanics = dataclasses.replace(self.mechanics, window_error=max(self.mechanics.window_error, 1e-5))
        return self._shown(self._path(logs, mechanics, self.longest, np.float32), self.steps + 1, mechanics, logs)

    def _shown(self, path: np.ndarray, after: np.ndarray, mechanics: Mechanics, logs: np.ndarray) -> np.ndarray:
        """Return a path [T, M, 3] at the instants, shape [N, M, 3]; without delays they come after so many of its steps
        [N]."""
        if not self.within:
            return path[after - 1].astype(np.float64)
        return between_steps(path, mechanics.time_step, self.since(logs))[0]

    def coarse_path(self, logs: np.ndarray) -> tuple[np.ndarray, int]:
        """Return displacements after every coarse step since the press began [T, M, 3], and how many steps one of them
        is."""
        mechanics, ratio = self.coarse_mechanics()
        return self._path(logs, mechanics, -(-self.longest // ratio), np.float32), ratio

    def coarser(self) -> Self:
        """Return the motion with the coarse time step."""
        return type(self)(self.contact, self.coarse_mechanics()[0], self.vertices, self.times, self.within)

    def coarse_mechanics(self) -> tuple[Mechanics, int]:
        """Return the simulator with a coarse time step, and how many of its own steps that is."""
        # Time step of simulations without derivatives [s].
        ratio = max(1, round(0.005 / self.mechanics.time_step))
        if not self.within and ((self.steps + 1) % ratio).any():
            ratio = 1
        time_step = ratio * self.mechanics.time_step
        return dataclasses.replace(self.mechanics, time_step=time_step, window_error=1e-3), ratio

    def _path(self, logs: np.ndarray, mechanics: Mechanics, steps: int, dtype: type, longer: float = 0.0) -> np.ndarray:
        load = self.load(logs, mechanics.time_step, steps, longer)
        return simulate(self.theta(logs), self.contact.mesh, load, mechanics, watch=self.vertices, dtype=dtype)


Kind = type[PressMotion]
"""Class of the motion that is fitted."""


def between_steps(values: np.ndarray, time_step: float, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Interpolate a quantity that is 0 at first, and its rate, between time steps: cubic through four of them.

    Args:
        values: after every step, shape [T, ...], T at least 3.
        time_step: [s].
        times: since the beginning, shape [N] [s]; at rest before.

    Returns:
        Shapes [N, ...] each.
    """
    place = np.clip(times / time_step, 0, len(values))
    first = np.clip(np.floor(place).astype(np.int64) - 1, 0, len(values) - 3)
    one, two, three = ((place - first)[:, None] - others for others in _OTHERS)
    weights = np.stack([one * two * three, (one * two + two * three + three * one) / time_step], axis=1)
    weights /= (np.arange(4.0) - _OTHERS).prod(axis=0)
    # After step i is values[i - 1]; at the beginning all is 0.
    steps = first[:, None] + np.arange(-1, 3)
    weights = np.where(steps[:, None] < 0, 0.0, weights)
    near = values[np.maximum(steps, 0)].reshape(*steps.shape, -1)
    found, rates = np.moveaxis(np.matmul(weights, near), 1, 0).reshape(2, len(times), *values.shape[1:])
    return found, rates


def about_tissue(information: np.ndarray, prior: np.ndarray, kept: int = 3) -> np.ndarray:
    """Return the information of (log k_s, log k_d, log |F|) alone, shape [3, 3], where other parameters are unknown.

    Args:
        information: of all parameters, those three first, shape [D, D].
        prior: of all parameters; only that of the others counts, shape [D, D].
        kept: of so many parameters instead of three.
    """
    others = information[kept:, kept:] + prior[kept:, kept:]
    return information[:kept, :kept] - information[:kept, kept:] @ np.linalg.solve(others, information[kept:, :kept])
