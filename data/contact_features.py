"""What a network is told about one contact: its motion since the onset and the mesh around it, as one vector.

Built the same way for training and for inference. Lengths are in units of the mesh's spacing at the contact, in which
the sheet's equations know no other scale than F; the noise and the spacing itself come beside.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from data.samples import ContactCase
from physics.mesh import Mesh

FRAME_RATE = 25.0
"""Motion is resampled to this rate [1/s]."""
SLOTS = 25
"""Instants after the onset that are told: one second."""
NEIGHBOURS = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))
"""(row, column) offsets of the pixels around the contact."""
FARTHEST_RIM = 32
"""Waves from a rim farther away don't return within a second [grid pixels]."""
FEATURES = 4 * SLOTS + 4 * len(NEIGHBOURS) + len(NEIGHBOURS) + 4
"""Length of the vector."""


@dataclass(frozen=True)
class Surroundings:
    """The mesh around a contact; the same for every instant of it."""

    spacing: float
    """Mean length of the contact's springs [scene units]."""
    vector: np.ndarray
    """Neighbours in the contact's own frame over the spacing, whether there are any, distances to the rim."""


def contact_features(
    case: ContactCase, time_step: float, seconds: float = math.inf, surroundings: Surroundings | None = None
) -> np.ndarray:
    """The vector of a contact, shape [FEATURES], float32.

    Args:
        case: the contact with its noise.
        time_step: of the case's steps [s].
        seconds: only what was seen until this long after the onset is told.
        surroundings: of the contact where they are known already.

    Raises:
        ValueError: the noise is not known.
    """
    if not (math.isfinite(case.noise) and case.noise > 0):
        raise ValueError(f"the contact's noise is {case.noise}; prepare the clip with geometry.smoothing above 0.")
    around = contact_surroundings(case) if surroundings is None else surroundings
    spacing = around.spacing
    relative_noise = case.noise / spacing
    times = (case.steps + 1) * time_step
    seen = times <= seconds + 1e-9
    slots = np.arange(1, SLOTS + 1) / FRAME_RATE
    known = np.zeros(SLOTS) if not seen.any() else (slots <= times[seen][-1] + 1e-9).astype(np.float64)
    along = np.zeros(SLOTS)
    if seen.any():
        pressed = -(case.displacement[seen] @ case.direction) / spacing
        along = known * np.interp(slots, np.concatenate(([0], times[seen])), np.concatenate(([0], pressed)))
    loaded = (slots <= min(case.load_steps * time_step, seconds) + 1e-9).astype(np.float64)
    scaled = np.arcsinh(along / (2 * relative_noise)) / 5
    scales = [math.log(spacing / 0.0027), math.log(relative_noise), math.log(relative_noise) ** 2 / 4, known.mean()]
    return np.concatenate([along / 8, scaled, known, loaded, around.vector, scales]).astype(np.float32)


def contact_spacing(mesh: Mesh, vertex: int) -> float:
    """Mean length of the springs at a vertex [scene units]."""
    ends = mesh.springs[(mesh.springs == vertex).any(axis=1)]
    return float(np.linalg.norm(mesh.vertices[ends[:, 1]] - mesh.vertices[ends[:, 0]], axis=1).mean())


def contact_surroundings(case: ContactCase) -> Surroundings:
    """Where the neighbours of a contact are and how far the rim is."""
    mesh, vertex = case.mesh, case.vertex
    spacing = contact_spacing(mesh, vertex)
    normal = np.asarray(case.direction, np.float64)
    across = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    across /= np.linalg.norm(across)
    frame = np.stack([across, np.cross(normal, across), normal])
    number = np.full((mesh.grid_shape[0] + 2, mesh.grid_shape[1] + 2), -1)
    number[tuple(mesh.pixels.T + 1)] = np.arange(len(mesh.vertices))
    centre = mesh.pixels[vertex] + 1
    shape, present, rims = np.zeros((len(NEIGHBOURS), 3)), np.zeros(len(NEIGHBOURS)), np.zeros(len(NEIGHBOURS))
    for index, offset in enumerate(NEIGHBOURS):
        neighbour = number[tuple(centre + offset)]
        if neighbour >= 0:
            present[index] = 1
            shape[index] = frame @ (mesh.vertices[neighbour] - mesh.vertices[vertex]) / spacing
        rims[index] = _steps_to_rim(number, mesh.rim, centre, np.array(offset)) / FARTHEST_RIM
    return Surroundings(spacing, np.concatenate([shape.ravel(), present, rims]))


def _steps_to_rim(number: np.ndarray, rim: np.ndarray, centre: np.ndarray, offset: np.ndarray) -> int:
    for step in range(1, FARTHEST_RIM):
        vertex = number[tuple(centre + step * offset)]
        if vertex < 0 or rim[vertex]:
            return step
    return FARTHEST_RIM
