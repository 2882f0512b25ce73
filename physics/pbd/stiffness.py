"""Stiffness that differs from particle to particle, and what it makes of every constraint."""

from typing import NamedTuple

import numpy as np

from palpate.physics.pbd.body import Body


class Stiffness(NamedTuple):
    """Fields over N particles, B of each or one for all (Liang 2024, section II-A), or derivatives by them.

    Weights of the energy ½ k C²: only k Δt²/m moves anything, so with m = 1 and Δt = 1 these numbers are shares of a
    particle's own inertia.
    """

    distance: np.ndarray
    """Of distances, shape [B, N] or [N] [N/m]."""
    shape: np.ndarray
    """Of shapes, likewise [N/m]."""
    volume: float | np.ndarray = 1e10
    """Of volumes, one for all, or of a derivative shape [B] [N/m⁵]."""


def spread(body: Body, fields: Stiffness) -> np.ndarray:
    """k of every constraint: the mean over its particles, shape [B, K], B = 1 for fields without that axis."""
    distance, shape = (np.atleast_2d(np.asarray(field, np.float64)) for field in fields[:2])
    found = np.empty((len(distance), len(body.layout.rest)))
    distances, volumes, shapes = body.kinds
    found[:, distances] = (body.averages[distances] @ distance.T).T
    found[:, volumes] = fields.volume
    found[:, shapes] = (body.averages[shapes] @ shape.T).T
    return found


def gather(body: Body, slopes: np.ndarray) -> Stiffness:
    """Derivatives by the fields [B, N] from those by every constraint's k [B, K]: the transpose of `spread`."""
    distances, volumes, shapes = body.kinds
    distance, shape = ((body.averages[kind].T @ slopes[:, kind].T).T for kind in (distances, shapes))
    return Stiffness(distance, shape, slopes[:, volumes].sum(axis=1))
