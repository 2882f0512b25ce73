"""Depth points laid onto a surface (ICP), and several depth views of a body at rest as one surface.

Besl & McKay 1992 with the distance along the normal instead of between points (Chen & Medioni 1992), and the farthest
pairs left out, as Frank 2010 (section VI-A) has it after Rusinkiewicz & Levoy 2001: where a tool deforms the object, it
does not fit the surface at rest.

Views (Frank 2010, section IV-A) are laid onto those before them one by one, from the poses that are believed, and then
each onto all others, so that errors don't add up around the body. Of what several views show the earliest is kept, as
in the zippering of Turk & Levoy 1994, whose seams are left open here: the mesher looks along six ways and passes small
gaps.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from palpate.data.source.sequence import moved
from palpate.estimators.palpation.skin import Match

KEPT = 0.7
"""Share of the pairs, those closest, that align."""
ROUNDS = 50
MOST_ALIGNED = 2000
"""Points that a pose needs at most."""
SHOWN = 1e-3
"""Singular value over the largest, from which on the surface shows a motion."""
STILL = 1e-7
"""Step of a point over the cloud's size, below which nothing changes any more."""
OVERLAP, SURROUNDED = 0.4, 0.5
"""Shares of a view's points by which it is aligned: with the views before it, and with all others around it."""
TURNS = 3
"""In which every view is laid onto all others."""
OVER = 0.7
"""Cosine of the angle to the normal beyond which a place lies aside of a surface."""
Triangles = tuple[np.ndarray, np.ndarray]
"""A surface: vertices [V, 3] [m], and triangles [F, 3]."""
SEAM = 0.6
"""Of the median edge: what lies closer to an earlier view is the same surface."""


def turned(pose: np.ndarray, step: np.ndarray) -> np.ndarray:
    """A pose [4, 4] after a small motion: rotation vector [rad] and shift [m] about the origin, shape [6]."""
    change = np.eye(4)
    change[:3, :3] = Rotation.from_rotvec(step[:3]).as_matrix()
    change[:3, 3] = step[3:]
    return change @ pose


def thinned(points: np.ndarray) -> np.ndarray:
    """At most MOST_ALIGNED of some points [P, 3], evenly."""
    return points[:: max(1, -(-len(points) // MOST_ALIGNED))]


def register(
    points: np.ndarray, surface: Triangles, pose: np.ndarray, kept: float = KEPT, shown: float = SHOWN
) -> np.ndarray:
    """Pose that lays points onto a surface.

    Args:
        points: in the sensor's frame, shape [P, 3] [m].
        surface: vertices, shape [V, 3] [m], and triangles, shape [F, 3].
        pose: to begin at: where the sensor was, as the tool that carries it says, shape [4, 4].
        kept: share of the pairs that align.
        shown: as SHOWN; facets alone show a ball's turns by a hundredth.

    Returns:
        shape [4, 4].
    """
    found = np.asarray(pose, np.float64)
    size = float(np.ptp(points, axis=0).max())
    for _ in range(ROUNDS):
        seen = moved(points, found)
        match = Match.of(seen, *surface)
        near = match.apart <= np.quantile(match.apart, kept)
        centre = seen[near].mean(axis=0)
        # Turned about the middle, and in units of the cloud's size, the six unknowns weigh equally.
        jacobian = np.hstack([np.cross((seen[near] - centre) / size, match.normal[near]), match.normal[near]])
        # A motion that the surface doesn't show, as within a plane, is left out.
        step = np.linalg.lstsq(jacobian, -match.distance[near], rcond=shown)[0]
        there, back = np.eye(4), np.eye(4)
        there[:3, 3], back[:3, 3] = -centre, centre
        found = back @ turned(there @ found, step / [size, size, size, 1, 1, 1])
        if np.abs(step).max() < STILL * size:
            break
    return found


@dataclass(frozen=True, eq=False)
class View:
    """A depth picture as an open surface, in its sensor's frame."""

    vertices: np.ndarray
    """Shape [V, 3] [m]."""
    triangles: np.ndarray
    """Shape [F, 3]."""
    pose: np.ndarray
    """Of the sensor, as it is believed, shape [4, 4]."""


def join_views(views: Sequence[View]) -> tuple[Triangles, list[np.ndarray], float]:
    """Register views and make one surface of them.

    Args:
        views: at least one; each shows a part of what those before it show.

    Returns:
        The surface in the first view's believed world, its triangles facing the sensors that saw them; poses of the
        sensors, aligned, each of shape [4, 4], the first one's as it was believed; and the root mean square distance of
        overlapping points from the other views' surface [m].

    Raises:
        ValueError: there is none, or one has no triangles.
    """
    if not views or not all(len(view.triangles) for view in views):
        raise ValueError("a view without triangles, or no view at all; give surfaces that the sensor saw.")
    poses = [np.asarray(views[0].pose, np.float64)]
    for number, view in enumerate(views[1:], start=1):
        poses.append(register(thinned(view.vertices), _together(views[:number], poses), view.pose, OVERLAP))
    for _ in range(TURNS if len(views) > 2 else 0):
        for number in range(1, len(views)):
            others = [index for index in range(len(views)) if index != number]
            rest = _together([views[index] for index in others], [poses[index] for index in others])
            poses[number] = register(thinned(views[number].vertices), rest, poses[number], SURROUNDED)
    whole = _oriented(views[0], poses[0])
    apart = []
    for number in range(1, len(views)):
        vertices, triangles = _oriented(views[number], poses[number])
        lengths = np.linalg.norm(vertices[triangles[:, 0]] - vertices[triangles[:, 1]], axis=1)
        match = Match.of(vertices[triangles].mean(axis=1), *whole)
        # What lies next to a rim, not over the surface, is new.
        over = np.abs(match.distance) >= OVER * match.apart
        same = (match.apart < SEAM * np.median(lengths)) & (over | (match.apart < 1e-6 * np.ptp(vertices)))
        apart.append(match.distance[same])
        whole = _united([whole, (vertices, triangles[~same])])
    used, which = np.unique(whole[1], return_inverse=True)
    off = np.concatenate(apart) if apart else np.zeros(0)
    rms = float(np.sqrt(np.mean(np.square(off)))) if len(off) else 0.0
    return (whole[0][used], which.reshape(-1, 3)), poses, rms


def _oriented(view: View, pose: np.ndarray) -> Triangles:
    """A view in the world, its triangles facing the sensor."""
    vertices = moved(view.vertices, pose)
    one, two, three = vertices[view.triangles].transpose(1, 0, 2)
    away = (np.cross(two - one, three - one) * (pose[:3, 3] - one)).sum(axis=1) < 0
    return vertices, np.where(away[:, None], view.triangles[:, ::-1], view.triangles)


def _together(views: Sequence[View], poses: Sequence[np.ndarray]) -> Triangles:
    return _united([_oriented(view, pose) for view, pose in zip(views, poses, strict=True)])


def _united(parts: Sequence[Triangles]) -> Triangles:
    """Surfaces side by side in one list of vertices."""
    begins = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    triangles = [faces + begin for (_, faces), begin in zip(parts, begins, strict=False)]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate(triangles)
