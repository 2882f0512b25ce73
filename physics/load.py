"""How a tool acts on tissue: it presses on a patch with a force, or it grips tissue and moves it.

Source: Bini 2026, section 3.3 (a force at the contact vertex, released after the first quarter) is the simplest
`Press`. A `Grip` prescribes what a force would have to reach; the force is then the reaction.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from physics.mesh import Mesh


@dataclass(frozen=True, eq=False)
class Press:
    """A force F·factor(t)·direction, shared out over the vertices of a patch; P vertices, T steps.

    Raises:
        ValueError: shapes that don't belong together, vertices that are no integers, weights that don't add up to 1,
            numbers that are not finite.
    """

    vertices: np.ndarray
    """Where it acts, the contact vertex first, shape [P], int64. None of them is ever held."""
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
    def at(cls, vertex: int, direction: np.ndarray, factor: np.ndarray) -> Press:
        """On one vertex."""
        return cls(np.array([vertex], np.int64), np.ones(1), np.asarray(direction), np.asarray(factor, np.float64))

    @classmethod
    def on_patch(cls, mesh: Mesh, vertex: int, radius: float, direction: np.ndarray, factor: np.ndarray) -> Press:
        """Spread smoothly, as 1 - (r/R)², over the vertices less than `radius` grid pixels from a vertex.

        Raises:
            ValueError: the radius is not positive.
        """
        if not radius > 0:
            raise ValueError(f"radius is {radius}; give a positive number of grid pixels.")
        apart = np.linalg.norm(mesh.pixels - mesh.pixels[vertex], axis=1)
        near = np.flatnonzero(apart < radius)
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

    def until(self, steps: int) -> Press:
        """The same over its first steps."""
        return dataclasses.replace(self, factor=self.factor[:steps])


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
    """Where each is after each step, from rest, shape [T, G, 3] [scene units]."""

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

    def until(self, steps: int) -> Grip:
        """The same over its first steps."""
        return dataclasses.replace(self, displacement=self.displacement[:steps])


Load = Press | Grip


def held(steps_loaded: float, steps: int) -> np.ndarray:
    """Share of every step that is under a load which begins at once and lasts so many steps, shape [steps]."""
    return np.clip(steps_loaded - np.arange(steps), 0.0, 1.0)


def ramped(rise: int, hold: int, fall: int, steps: int) -> np.ndarray:
    """A load that rises, holds and falls, each over so many steps, at the middle of every step, shape [steps]."""
    corners = np.cumsum([0, rise, hold, fall])
    return np.interp(np.arange(steps) + 0.5, corners, [0.0, 1.0, 1.0, 0.0], right=0.0)


def _require_vertices(vertices: np.ndarray) -> None:
    _require("vertices", vertices, (np.size(vertices),))
    if np.asarray(vertices).dtype.kind not in "iu":
        raise ValueError(f"vertices are of type {np.asarray(vertices).dtype}; give indices, which are integers.")


def _require(name: str, values: np.ndarray, shape: tuple[int, ...]) -> None:
    if np.shape(values) != shape or 0 in shape:
        raise ValueError(f"{name} has shape {np.shape(values)}; give {shape}, one entry at least.")
    if not np.isfinite(values).all():
        raise ValueError(f"{name} holds a number that is not finite.")
