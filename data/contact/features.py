"""Input of a network for one contact: its motion since the onset and the mesh around it, as one vector.

It is built the same way for training and for inference. Lengths are in units of the mesh's spacing at the contact, in
which F is the only scale of the sheet's equations. The noise and the spacing itself are given as well.
"""

from dataclasses import dataclass

import numpy as np

from palpate.data.contact.interaction import Interaction
from palpate.physics.mesh import Mesh

FRAME_RATE = 25.0
"""Rate to which motion is resampled [1/s]."""
SLOTS = 25
"""Number of instants after the onset: one second."""
NEIGHBOURS = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))
"""(row, column) offsets of the pixels around the contact."""
FEATURES = 4 * SLOTS + 4 * len(NEIGHBOURS) + len(NEIGHBOURS) + 4
"""Length of the vector."""
REFERENCE_SPACING = 0.0027
"""Usual spacing of the mesh at the contact [scene units]."""
KNOWN, LOADED = (tuple(range(first * SLOTS, (first + 1) * SLOTS)) for first in (2, 3))
"""Places in the vector that are 1 for instants that were observed, and for those observed under load."""
LOG_NOISE = FEATURES - 4, FEATURES - 3
"""Places in the vector whose sum is the logarithm of the noise over REFERENCE_SPACING."""


@dataclass(frozen=True)
class Surroundings:
    """The mesh around a contact; the same for every instant of it."""

    spacing: float
    """Mean length of the contact's springs [scene units]."""
    vector: np.ndarray
    """Neighbours in the contact's own frame over the spacing, their presence, distances to the rim."""


def contact_features(contact: Interaction, surroundings: Surroundings | None = None) -> np.ndarray:
    """The vector of a contact, shape [FEATURES], float32.

    Every instant up to the last observation counts as known, as in training at 25 frames a second. At lower rates, or
    without depth in some frames, instants are interpolated: the contact seems better observed than it is.

    Args:
        contact: with its noise, which must be known.
        surroundings: known surroundings of the contact.
    """
    around = contact_surroundings(contact) if surroundings is None else surroundings
    times = contact.observation.times
    slots = slot_times()
    known, along = np.zeros(SLOTS), np.zeros(SLOTS)
    if len(times):
        known = (slots <= times[-1] + 1e-9).astype(np.float64)
        pressed = -(contact.moved @ contact.direction) / around.spacing
        along = np.interp(slots, np.concatenate(([0], times)), np.concatenate(([0], pressed)))
    loaded = (slots <= contact.load_seconds + 1e-9) * known
    scales = np.array([around.spacing]), np.array([contact.noise])
    return join_features(along[None], known[None], loaded[None], around.vector[None], *scales)[0]


def slot_times() -> np.ndarray:
    """Times since the onset that are given, shape [SLOTS] [s]."""
    return np.arange(1, SLOTS + 1) / FRAME_RATE


def join_features(
    along: np.ndarray, known: np.ndarray, loaded: np.ndarray, around: np.ndarray, spacing: np.ndarray, noise: np.ndarray
) -> np.ndarray:
    """Vectors of many contacts, shape [B, FEATURES], float32.

    Args:
        along: motion against the force's direction over the spacing, shape [B, SLOTS].
        known, loaded: 1 for observed instants, and for those under load, shapes [B, SLOTS].
        around: `Surroundings.vector`, shape [B, 40].
        spacing: spacing of the meshes, shape [B] [scene units].
        noise: σ of every observed coordinate, shape [B] [scene units].
    """
    relative = (noise / spacing)[:, None]
    along = along * known
    logs = np.log(relative)
    size, share = np.log(spacing / REFERENCE_SPACING)[:, None], known.mean(axis=1, keepdims=True)
    scales = np.concatenate([size, logs, logs**2 / 4, share], axis=1)
    scaled = np.arcsinh(along / (2 * relative)) / 5
    return np.concatenate([along / 8, scaled, known, loaded, around, scales], axis=1).astype(np.float32)


def contact_spacing(mesh: Mesh, vertex: int) -> float:
    """Mean length of the springs at a vertex [scene units]."""
    begin, end = mesh.springs.T
    ends = mesh.springs[(begin == vertex) | (end == vertex)]
    return float(np.linalg.norm(mesh.vertices[ends[:, 1]] - mesh.vertices[ends[:, 0]], axis=1).mean())


def contact_surroundings(contact: Interaction) -> Surroundings:
    """Neighbours of a contact and distances to the rim."""
    mesh, vertex = contact.mesh, contact.vertex
    spacing = contact_spacing(mesh, vertex)
    normal = np.asarray(contact.direction, np.float64)
    across = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    across /= np.linalg.norm(across)
    frame = np.stack([across, np.cross(normal, across), normal])
    number = np.full((mesh.grid_shape[0] + 2, mesh.grid_shape[1] + 2), -1)
    number[tuple(mesh.pixels.T + 1)] = np.arange(len(mesh.vertices))
    centre = mesh.pixels[vertex] + 1
    farthest = 32  # waves from a rim farther away don't return within a second [grid pixels]
    # Around the grid there are no vertices.
    places = centre + np.arange(1, farthest)[:, None, None] * np.array(NEIGHBOURS)
    ahead = number[tuple(np.moveaxis(places.clip(0, np.array(number.shape) - 1), -1, 0))]
    present, ends = ahead[0] >= 0, (ahead < 0) | mesh.rim[ahead]
    shape = (mesh.vertices[ahead[0]] - mesh.vertices[vertex]) @ frame.T / spacing * present[:, None]
    rims = np.where(ends.any(axis=0), (ends.argmax(axis=0) + 1) / farthest, 1.0)
    return Surroundings(spacing, np.concatenate([shape.ravel(), present, rims]))
