"""Observation of moving tissue: displacements of tracked points with instants and noise, and their likelihood."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from palpate.physics.identifiability import fisher_information


class Linearised(NamedTuple):
    """A likelihood around one φ of D parameters; K observed coordinates."""

    residual: np.ndarray
    """(Φ - d)/σ, shape [K]."""
    jacobian: np.ndarray
    """Derivatives of the residual by φ, shape [K, D]."""

    @property
    def misfit(self) -> float:
        """½ Σ r², the negative log likelihood up to a constant."""
        return 0.5 * float(self.residual @ self.residual)

    @property
    def gradient(self) -> np.ndarray:
        """Gradient of the misfit by φ, shape [D]."""
        return self.jacobian.T @ self.residual

    @property
    def information(self) -> np.ndarray:
        """Fisher information of φ, shape [D, D]."""
        return fisher_information(self.jacobian, 1.0)


class CommonErrors:
    """Normal errors that values share besides independent ones of variance 1.

    Args:
        columns: change of K values by a standard deviation of each of M errors, shape [..., K, M].
    """

    def __init__(self, columns: np.ndarray) -> None:
        self._columns, self._rows = columns, columns.swapaxes(-1, -2)
        self._factor = np.linalg.cholesky(self._rows @ columns + np.eye(columns.shape[-1]))

    def marginalised(self, values: np.ndarray) -> np.ndarray:
        """Whiten values [..., K, D]: products of the result [..., K + M, D] are those by the whole covariance's
        inverse.
        """
        common = np.linalg.solve(self._factor, self._rows @ values)
        common = np.linalg.solve(self._factor.swapaxes(-1, -2), common)
        return np.concatenate([values - self._columns @ common, common], axis=-2)


@dataclass(frozen=True, eq=False)
class Observation:
    """Displacements of M tracked points of a mesh at N instants.

    Raises:
        ValueError: shapes that don't belong together, times that are not finite.
    """

    vertices: np.ndarray
    """Mesh vertex that each point is, shape [M], int64."""
    times: np.ndarray
    """Times since the load began, ascending, shape [N] [s]."""
    displacement: np.ndarray
    """Displacements from rest, shape [M, N, 3], float32 [scene units]; NaN where a point was not observed."""
    noise: np.ndarray
    """Standard deviation by axis of the camera, of shape [3] or any that broadcasts to [M, N, 3] [scene units]; NaN
    where it isn't known."""

    def __post_init__(self) -> None:
        expected = (len(self.vertices), len(self.times), 3)
        if np.shape(self.displacement) != expected:
            raise ValueError(f"displacement has shape {np.shape(self.displacement)}; give {expected}.")
        if not np.isfinite(self.times).all():
            raise ValueError("times holds a number that is not finite; leave out instants without a time.")
        try:
            np.broadcast_to(self.noise, expected)
        except ValueError:
            shape = np.shape(self.noise)
            raise ValueError(f"noise has shape {shape}; give [3] or one that broadcasts to {expected}.") from None

    @classmethod
    def of_point(cls, vertex: int, times: np.ndarray, displacement: np.ndarray, noise: float) -> "Observation":
        """One point, displacements of shape [N, 3], with the same noise along every axis."""
        moved = np.asarray(displacement, np.float32).reshape(1, -1, 3)
        return cls(np.array([vertex], np.int64), np.asarray(times, np.float64), moved, np.full(3, noise, np.float64))

    def __len__(self) -> int:
        """N."""
        return len(self.times)

    @property
    def depth_noise(self) -> float:
        """Standard deviation along the camera's axis, root mean square over points and instants [scene units]."""
        by_axis = np.broadcast_to(self.noise, np.broadcast_shapes(np.shape(self.noise), (3,))).astype(np.float64)
        return float(np.sqrt(np.square(by_axis[..., 2]).mean()))

    def steps(self, time_step: float) -> np.ndarray:
        """Index into a trajectory with this time step [s] that each instant is nearest to, shape [N], int64."""
        return np.rint(self.times / time_step).astype(np.int64) - 1

    def chosen(self, instants: np.ndarray) -> "Observation":
        """Return the observation at some of its instants: a mask [N] or indices."""
        noise = self.noise
        if np.ndim(noise) >= 2 and np.shape(noise)[-2] == len(self.times):
            noise = noise[..., instants, :]
        return replace(self, times=self.times[instants], displacement=self.displacement[:, instants], noise=noise)

    def moved(self, displacement: np.ndarray, noise: float) -> "Observation":
        """Return the observation at instants with other displacements, of shape [M, N, 3] or [N, 3], and another noise
        on every axis."""
        displacement = np.asarray(displacement, np.float32).reshape(self.displacement.shape)
        return replace(self, displacement=displacement, noise=np.full(3, noise, np.float64))

    def linearise(self, moved: np.ndarray, slopes: np.ndarray, _: np.ndarray | None = None) -> Linearised:
        """Residual in standard deviations, and its derivatives, of displacements [N, M, 3] with slopes [N, M, 3, D]."""
        seen = np.isfinite(self.displacement)
        observed, noise = self.displacement.astype(np.float64)[seen], np.broadcast_to(self.noise, seen.shape)[seen]
        moved, slopes = (np.moveaxis(values, 1, 0)[seen] for values in (moved, slopes))
        return Linearised((moved - observed) / noise, slopes / noise[:, None])
