"""Loads of a tool on tissue: it presses on a patch with a force, or it grips tissue and moves it.

Source: Bini 2026, section 3.3 (a force at the contact vertex, released after the first quarter) is the simplest
`Press`. A `Grip` prescribes what a force would have to reach; the force is then the reaction.
"""

from dataclasses import dataclass, replace

import numpy as np

from palpate.physics.mesh import Mesh

Pair = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Press:
    """A force F·factor(t)·direction, shared out over the vertices of a patch; P vertices, T steps.

    Raises:
        ValueError: shapes that don't belong together, vertices that are no integers, weights that don't add up to 1,
            numbers that are not finite.
    """

    vertices: np.ndarray
    """Vertices on which it acts, the contact vertex first, shape [P], int64. None of them is ever held."""
    weights: np.ndarray
    """Share of the force on each, shape [P], sum 1."""
    direction: np.ndarray
    """Unit vector along which a positive F acts, shape [3]."""
    factor: np.ndarray
    """Share of F in each step, shape [T]."""

    def __post_init__(self) -> None:
        _require_vertices(self.vertices)
        _require("weights", self.weights, np.shape(self.vertices))
        _require("direction", self.direction, (3,))
        _require("factor", self.factor, (np.size(self.factor),))
        total = float(np.sum(self.weights, dtype=np.float64))
        if abs(total - 1) > 1e-6:
            raise ValueError(f"weights add up to {total:g}; give shares of one force.")

    @classmethod
    def at(cls, vertex: int, direction: np.ndarray, factor: np.ndarray) -> "Press":
        """Press on one vertex."""
        return cls(np.array([vertex], np.int64), np.ones(1), np.asarray(direction), np.asarray(factor, np.float64))

    @classmethod
    def on_patch(
        cls, mesh: Mesh, vertex: int, radius: float, direction: np.ndarray, factor: np.ndarray, offset: Pair = (0, 0)
    ) -> "Press":
        """Spread smoothly, as 1 - (r/R)², over the vertices less than `radius` grid pixels from a place.

        Args:
            mesh, vertex: vertex of a mesh.
            offset: rows and columns from it to the place [grid pixels].
            radius: R [grid pixels]. Where no vertex is so near, the nearest one bears the whole force.
            direction, factor: direction and factor of the `Press`.

        Raises:
            ValueError: the radius is not positive.
        """
        if not radius > 0:
            raise ValueError(f"radius is {radius}; give a positive number of grid pixels.")
        apart = np.linalg.norm(mesh.pixels - mesh.pixels[vertex] - np.asarray(offset, np.float64), axis=1)
        near = np.flatnonzero(apart < radius)
        if not len(near):
            return cls.at(int(np.argmin(apart)), direction, factor)
        near = near[np.argsort(apart[near], kind="stable")]
        weights = 1 - np.square(apart[near] / radius)
        return cls(near, weights / weights.sum(), np.asarray(direction), np.asarray(factor, np.float64))

    @property
    def vertex(self) -> int:
        """The contact vertex."""
        return int(self.vertices[0])

    @property
    def steps(self) -> int:
        """T."""
        return len(self.factor)

    def until(self, steps: int) -> "Press":
        """Return the press over its first steps."""
        return replace(self, factor=self.factor[:steps])


@dataclass(frozen=True, eq=False)
class Grip:
    """Tissue that is moved along a given path from its rest; G vertices, T steps.

    Raises:
        ValueError: shapes that don't belong together, vertices that are no integers, a vertex named twice, numbers that
            are not finite.
    """

    vertices: np.ndarray
    """The gripped ones, shape [G], int64."""
    displacement: np.ndarray
    """Displacement of each from rest after each step, shape [T, G, 3] [scene units]."""

    def __post_init__(self) -> None:
        _require_vertices(self.vertices)
        _require("displacement", self.displacement, (*np.shape(self.displacement)[:1], len(self.vertices), 3))
        if len(np.unique(self.vertices)) < len(self.vertices):
            raise ValueError("vertices names one twice; a gripped vertex has one path.")

    @property
    def vertex(self) -> int:
        """The first of the gripped vertices."""
        return int(self.vertices[0])

    @property
    def steps(self) -> int:
        """T."""
        return len(self.displacement)

    def until(self, steps: int) -> "Grip":
        """Return the grip over its first steps."""
        return replace(self, displacement=self.displacement[:steps])


Load = Press | Grip


def held(steps_loaded: float, steps: int) -> np.ndarray:
    """Share of every step under a load that begins at once and lasts `steps_loaded` steps, shape [steps]."""
    return np.clip(steps_loaded - np.arange(steps), 0.0, 1.0)


def ramped(rise: float, hold: float, fall: float, steps: int) -> np.ndarray:
    """A load that rises, holds and falls, each over a number of steps: its mean over every step, shape [steps].

    It never falls where `hold` is infinite. Where `hold` is negative it begins to fall before it has risen, as fast as
    it would otherwise: the difference of two ramps.
    """
    at = np.arange(steps + 1.0)
    return np.diff(_ramp_integral(at, rise) - _ramp_integral(at - (rise + hold), fall))


def _ramp_integral(time: np.ndarray, rise: float) -> np.ndarray:
    """Integral up to a time, any shape, of a function that is 0 before 0 and rises to 1 over `rise`."""
    time = np.maximum(time, 0.0)
    return np.where(time < rise, np.square(time) / (2 * rise) if rise > 0 else 0.0, time - rise / 2)


@dataclass(frozen=True)
class PressShape:
    """Patch of a press, its direction, and rise and fall of its force.

    As it stands, a step along the normal on one vertex.
    """

    radius: float = 0.0
    """R of `Press.on_patch` [grid pixels]; 0 = on one vertex."""
    offset: Pair = (0.0, 0.0)
    """Offset of the patch's middle from the contact vertex, rows and columns [grid pixels]."""
    rise: float = 0.0
    """Time that the force takes to rise to F [s]."""
    fall: float = 0.0
    """Time that it takes to fall from F to nothing, before the load's end [s]."""
    lean: Pair = (0.0, 0.0)
    """Lean of a positive F: its parts towards the picture's right and lower side over its part along the normal."""

    def leaning(self, normal: np.ndarray) -> np.ndarray:
        """Unit vector along which a positive F acts, of a normal [3] that is not the picture's x axis, shape [3]."""
        normal = np.asarray(normal, np.float64)
        right = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
        right /= np.linalg.norm(right)
        # The normal points towards the camera, against z.
        found = normal + self.lean[0] * right + self.lean[1] * np.cross(right, normal)
        return found / np.linalg.norm(found)

    def factor(self, seconds: float, time_step: float, steps: int) -> np.ndarray:
        """Share of F in each step, shape [steps]; arguments as in `press`."""
        rise, fall = self.rise / time_step, self.fall / time_step
        return ramped(rise, seconds / time_step - rise - fall, fall, steps)

    def press(self, mesh: Mesh, vertex: int, normal: np.ndarray, seconds: float, time_step: float, steps: int) -> Press:
        """The load of this shape.

        Args:
            mesh, vertex: arguments of `Press.on_patch`.
            normal: normal of the surface, shape [3].
            seconds: time under load; infinite where it does not end.
            time_step, steps: time step [s] and number of steps of the simulation.
        """
        direction, factor = self.leaning(normal), self.factor(seconds, time_step, steps)
        if not self.radius:
            return Press.at(vertex, direction, factor)
        return Press.on_patch(mesh, vertex, self.radius, direction, factor, self.offset)


def _require_vertices(vertices: np.ndarray) -> None:
    _require("vertices", vertices, (np.size(vertices),))
    if np.asarray(vertices).dtype.kind not in "iu":
        raise ValueError(f"vertices are of type {np.asarray(vertices).dtype}; give indices, which are integers.")


def _require(name: str, values: np.ndarray, shape: tuple[int, ...]) -> None:
    if np.shape(values) != shape or 0 in shape:
        raise ValueError(f"{name} has shape {np.shape(values)}; give {shape}, one entry at least.")
    if not np.isfinite(values).all():
        raise ValueError(f"{name} holds a number that is not finite.")
