"""Stiffness that differs from particle to particle, and the stiffness of every constraint."""

from typing import NamedTuple

import numpy as np

from palpate.physics.pbd.body import Body


class Stiffness(NamedTuple):
    """Fields over N particles, B of each or one for all (Liang 2024, section II-A), or derivatives by them.

    Weights of the energy ½ k C²: only k Δt²/m moves anything, so with m = 1 and Δt = 1 these numbers are shares of a
    particle's own inertia.
    """

    distance: np.ndarray
    """Stiffness of distances, shape [B, N] or [N] [N/m]."""
    shape: np.ndarray
    """Stiffness of shapes, likewise [N/m]."""
    volume: float | np.ndarray = 1e10
    """Stiffness of volumes, one for all, or of a derivative shape [B] [N/m⁵]."""

    @property
    def total(self) -> np.ndarray:
        """Derivatives by fields that served all B, of distances and of shapes, shape [2, N]."""
        return np.stack(self[:2]).sum(axis=1)


def spread(body: Body, fields: Stiffness) -> np.ndarray:
    """k of every constraint: the mean over its particles, shape [B, K], B = 1 for fields without that axis.

    Raises:
        ValueError: shapes that don't fit, numbers that are negative or not finite.
    """
    distance, shape = (np.atleast_2d(np.asarray(field, np.float64)) for field in fields[:2])
    for name, field in (("distance", distance), ("shape", shape)):
        if field.ndim != 2 or field.shape[1] != body.count:
            raise ValueError(f"stiffness of {name} has shape {field.shape}; give one number a particle, {body.count}.")
        if not (np.isfinite(field).all() and (field >= 0).all()):
            raise ValueError(f"stiffness of {name} holds a number that is negative or not finite.")
    if len(distance) != len(shape):
        raise ValueError(f"there are {len(distance)} fields of distance and {len(shape)} of shape; give as many.")
    if not (np.isfinite(fields.volume) and np.ndim(fields.volume) == 0 and fields.volume >= 0):
        raise ValueError(f"stiffness of volume is {fields.volume}; give one number, 0 or more.")
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
