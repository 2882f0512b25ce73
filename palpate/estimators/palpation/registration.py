"""Depth points laid onto a surface (ICP).

It is Besl & McKay 1992 with the distance along the normal instead of between points (Chen & Medioni 1992). The farthest
pairs are left out (Frank 2010, section VI-A, after Rusinkiewicz & Levoy 2001), since a pressed object does not fit the
surface at rest.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from palpate.data.source.sequence import moved
from palpate.estimators.palpation.skin import Match

MOST_ALIGNED = 2000
"""Points that a pose needs at most."""

Triangles = tuple[np.ndarray, np.ndarray]
"""A surface: vertices [V, 3] [m], and triangles [F, 3]."""


def turned(pose: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Return a pose [4, 4] after a small motion: rotation vector [rad] and shift [m] about the origin, shape [6]."""
    change = np.eye(4)
    change[:3, :3] = Rotation.from_rotvec(step[:3]).as_matrix()
    change[:3, 3] = step[3:]
    return change @ pose


def thinned(points: np.ndarray) -> np.ndarray:
    """Return at most MOST_ALIGNED of some points [P, 3], evenly."""
    return points[:: max(1, -(-len(points) // MOST_ALIGNED))]


def register(points: np.ndarray, surface: Triangles, pose: np.ndarray, shown: float = 1e-3) -> np.ndarray:
    """Return the pose that lays points onto a surface.

    Args:
        points: in the sensor's frame, shape [P, 3] [m].
        surface: vertices, shape [V, 3] [m], and triangles, shape [F, 3].
        pose: to begin at: where the sensor was, as the tool that carries it says, shape [4, 4].
        shown: singular value over the largest, from which on the surface shows a motion; facets alone show a ball's
            turns by a hundredth.

    Returns:
        shape [4, 4].
    """
    found = np.asarray(pose, np.float64)
    size = float(np.ptp(points, axis=0).max())
    for _ in range(50):
        placed = moved(points, found)
        match = Match.of(placed, *surface)
        # Share of the pairs, those closest, that align.
        near = match.apart <= np.quantile(match.apart, 0.7)
        centre = placed[near].mean(axis=0)
        # Turned about the middle, and in units of the cloud's size, the six unknowns weigh equally.
        jacobian = np.hstack([np.cross((placed[near] - centre) / size, match.normal[near]), match.normal[near]])
        # A motion that the surface doesn't show, as within a plane, is left out.
        step = np.linalg.lstsq(jacobian, -match.distance[near], rcond=shown)[0]
        there, back = np.eye(4), np.eye(4)
        there[:3, 3], back[:3, 3] = -centre, centre
        found = back @ turned(there @ found, step / [size, size, size, 1, 1, 1])
        if np.abs(step).max() < 1e-7 * size:
            break
    return found
