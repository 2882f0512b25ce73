"""Contacts with brightness sequences, made by hand."""

import numpy as np

from palpate.data.contact.interaction import Interaction
from palpate.data.shading.sequence import ShadingSequence
from palpate.physics import Mesh, Observation, Press, grid_mesh, held

FOCAL, DISTANCE, RADIUS = 160.0, 0.4, 12
"""Focal length [grid pixels], distance of the tissue [scene units], and rows from the contact to its rim."""


def facing(distance: float = DISTANCE, focal: float = FOCAL, radius: int = RADIUS) -> tuple[Mesh, int]:
    """Tissue that faces the camera, and the vertex in its middle."""
    rows, columns = np.indices((2 * radius + 1,) * 2) - radius
    rays = np.stack([columns / focal, rows / focal, np.ones(rows.shape)], axis=-1)
    mesh = grid_mesh(distance * rays, np.ones(rows.shape, bool))
    return mesh, int(np.flatnonzero((mesh.pixels == radius).all(axis=1))[0])


def lit_contact(times: np.ndarray, change: np.ndarray) -> Interaction:
    """A press of 0.3 s on it, whose light of all colours changes so [N, L, L]."""
    mesh, vertex = facing()
    load = Press.at(vertex, np.array([0, 0, -1], np.float32), held(30, 100))
    change = np.repeat(change[:, None], 3, axis=1).astype(np.float32)
    light = ShadingSequence(times, change, np.zeros(change.shape[1:]), np.full(3, 0.01))
    observed = Observation.of_point(vertex, times, np.zeros((len(times), 3)), np.nan)
    return Interaction(mesh, load, {"point": observed, "shading": light}, 0.01)
