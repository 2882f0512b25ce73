"""Where tissue is held, found by its motion alone: where a sheet gripped there explains the most of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data.tracks.holding import background_terms, least_distances
from estimators.grip.lattice import lattice_springs
from estimators.grip.sheet_fit import LEAST_AROUND
from physics.sheet import equilibrium

COARSER = 2
"""Every so many points of the grid along an axis are nodes."""
RATIOS = (0.01, 0.04)
"""Of foundation to springs between those nodes that are tried; motion dies away over √(3/ratio) of their spacings."""
APART, RADIUS = 3, 1.5
"""Distance between the places that are tried, and how far around one tissue is held [distances of nodes]."""
LEAST_HELD = 4
"""Nodes."""


@dataclass(frozen=True, eq=False)
class Driver:
    """What drives tissue; N points."""

    place: np.ndarray
    """Where it is held, at rest, shape [2] (column, row) [px]."""
    own: np.ndarray
    """Displacement of every point beside the background that explains most of them, shape [N, 2] [px]; not a number
    where one is lost."""
    left: float
    """Mean distance of the motion from the sheet's and the background's, over that from the background's alone."""


def find_driver(points: np.ndarray, spacing: int, moved: np.ndarray, camera: bool) -> Driver | None:
    """The place where a sheet, held as the tissue there moves, leaves least of the motion; None with too few points.

    Places all over the picture are tried, because under a moving camera a piece of tissue that is nearer to it moves
    most. The background is found with the sheet, by least distances.

    Args:
        points: places at rest on a grid, shape [N, 2] (column, row) [px].
        spacing: of the grid [px].
        moved: displacements, shape [N, 2] [px]; not a number where a point is lost.
        camera: whether the camera moves, so that the background moves as a quadratic function of place, not an affine.
    """
    nodes = (np.rint(points / spacing).astype(int) % COARSER == 0).all(axis=1) & np.isfinite(moved).all(axis=1)
    if nodes.sum() < LEAST_AROUND:
        return None
    all_terms = background_terms(points, camera)
    step, places, motion, terms = COARSER * spacing, points[nodes].astype(np.float64), moved[nodes], all_terms[nodes]
    springs = lattice_springs(places, step)
    own = moved - all_terms @ least_distances(terms, motion)
    still = float(np.linalg.norm(own[nodes], axis=1).mean())
    best: Driver | None = None
    for place in _tried(places, APART * step):
        held = np.linalg.norm(places - place, axis=1) <= RADIUS * step
        if held.sum() < LEAST_HELD:
            continue
        given = np.hstack([motion[held], terms[held]])
        for ratio in RATIOS:
            found = equilibrium(springs, np.ones(len(springs)), np.full(len(places), ratio), held, given).displacement
            follows, pulled = terms - found[:, 2:], motion - found[:, :2]
            off = np.linalg.norm(pulled - follows @ least_distances(follows, pulled), axis=1).mean()
            left = float(off / max(still, np.finfo(float).tiny))
            if best is None or left < best.left:
                best = Driver(place, own, left)
    return best


def _tried(places: np.ndarray, apart: float) -> np.ndarray:
    """A square grid over some places, shape [P, 2] [px]."""
    low, high = places.min(axis=0), places.max(axis=0)
    columns, rows = (np.arange(one + apart / 2, other, apart) for one, other in zip(low, high, strict=True))
    return np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
