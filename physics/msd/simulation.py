"""Forward simulation: numpy in, numpy out, no torch; compiled where numba is installed.

Source: Bini 2026, section 3.4.4 (forward simulation with the estimated parameters) and equation 9.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from physics import jit
from physics.load import Grip, Load
from physics.mechanics import Mechanics
from physics.mesh import Mesh
from physics.msd import compiled, reference
from physics.msd.compiled import Case, Watched

SENSITIVITY_LIMIT = {np.dtype(np.float32): 100.0, np.dtype(np.float64): 1e8}
"""Relative change of the trajectory for a relative change of θ from which on rounding spoils the derivatives.

Measured in single precision on a 14,800-vertex mesh: below 20 they agree with double precision to 1 %, at 100 to 10 %.
"""


def simulate(
    theta: ArrayLike,
    mesh: Mesh,
    load: Load,
    mechanics: Mechanics,
    *,
    watch: np.ndarray | None = None,
    dtype: type = np.float32,
) -> np.ndarray:
    """Displacement of a few vertices after each step.

    Args:
        theta: k_s, k_d and signed F, shape [3] [normalised]; F means nothing under a grip.
        mesh: the mesh at rest.
        load: what acts on it; its number of steps T is the simulation's.
        mechanics: constants.
        watch: vertices, shape [M]; None = the load's first one.
        dtype: float32 or float64, the precision of the computation.

    Returns:
        Shape [T, M, 3], or [T, 3] without `watch` [scene units]; index i is the time (i+1)·Δt.

    Raises:
        ValueError: a shape, an index or a value that makes no sense.
    """
    path = _watched(_case(theta, mesh, load, mechanics, watch, dtype), sensitive=False).path
    return path[:, 0] if watch is None else path


def simulate_sensitivities(
    theta: ArrayLike,
    mesh: Mesh,
    load: Load,
    mechanics: Mechanics,
    *,
    watch: np.ndarray | None = None,
    dtype: type = np.float32,
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement [T, M, 3] and its exact derivatives by k_s, k_d and F [T, M, 3, 3], in one pass.

    Arguments and errors as in `simulate`; without `watch` the second axis is left out. The last axis is θ's.
    """
    path, slopes = _watched(_case(theta, mesh, load, mechanics, watch, dtype), sensitive=True)[:2]
    return (path[:, 0], slopes[:, 0]) if watch is None else (path, slopes)


def simulate_field(
    theta: ArrayLike, mesh: Mesh, load: Load, mechanics: Mechanics, *, dtype: type = np.float32
) -> np.ndarray:
    """Displacement of every vertex after each step, shape [T, N, 3] [scene units]; arguments as in `simulate`."""
    case = _case(theta, mesh, load, mechanics, None, dtype)
    if jit.COMPILED:
        field = np.empty((load.steps, len(mesh.vertices), 3), dtype)
        compiled.field_rollout(case, field)
        return field
    jit.say_slow()
    return np.stack([step.displacement for step in reference.steps(*case[:4])])


def simulate_reaction(
    theta: ArrayLike, mesh: Mesh, grip: Grip, mechanics: Mechanics, *, dtype: type = np.float32
) -> tuple[np.ndarray, np.ndarray]:
    """Force with which a grip holds each of its vertices [T, G, 3], and its derivatives by k_s and k_d [T, G, 3, 2].

    Arguments and errors as in `simulate`. The force of step i acts between the times i·Δt and (i+1)·Δt. Always exact:
    a window is checked by where watched vertices go, and gripped ones go where they are put.
    """
    exact = dataclasses.replace(mechanics, window_error=0.0)
    case = _case(theta, mesh, grip, exact, grip.vertices, dtype)
    elastic, slopes = _watched(case, sensitive=True)[2:]
    # Inertia and damping of the gripped vertices themselves depend on k_d alone.
    force, by_damping = reference.reaction(elastic, grip, case.theta[1], mechanics)
    return force.astype(dtype), np.stack([-slopes[..., 0], by_damping - slopes[..., 1]], axis=-1).astype(dtype)


def is_chaotic(path: np.ndarray, log_slopes: np.ndarray) -> bool:
    """Whether a motion reacts so strongly to φ that rounding decides its derivatives; shapes [T, …] and [T, …, D]."""
    return bool(np.abs(log_slopes).max(initial=0) > SENSITIVITY_LIMIT[path.dtype] * np.abs(path).max(initial=0))


def _watched(case: Case, sensitive: bool) -> Watched:
    """One rollout, compiled or plain."""
    if jit.COMPILED:
        return compiled.watched_rollout(case, sensitive)
    jit.say_slow()
    watch, held = case.watch, case.load.vertices
    found = [
        (
            step.displacement[watch],
            np.moveaxis(step.moved[:, watch], 0, -1),
            step.elastic[held],
            np.moveaxis(step.elastic_moved[:, held], 0, -1),
        )
        for step in reference.steps(*case[:4], sensitive=sensitive)
    ]
    return Watched(*(np.stack(values) for values in zip(*found, strict=True)))


def _case(theta, mesh, load, mechanics, watch, dtype) -> Case:
    """The arguments as one checked case, or a ValueError that says what is wrong."""
    theta = np.asarray(theta, dtype=dtype)
    if theta.shape != (3,) or not np.isfinite(theta).all():
        raise ValueError(f"theta is {theta.tolist()}; give three finite numbers k_s, k_d and F.")
    if theta[0] < 0 or theta[1] < 0:
        raise ValueError(f"theta has k_s = {theta[0]:g} and k_d = {theta[1]:g}; neither may be negative.")
    watch = np.asarray(load.vertices[:1] if watch is None else watch)
    if watch.ndim != 1 or watch.size == 0 or watch.dtype.kind not in "iu":
        raise ValueError(f"watch has shape {watch.shape} and type {watch.dtype}; give [M] indices, one at least.")
    watch = watch.astype(np.int64)
    compiled.require_inside(mesh, load, watch)
    return Case(theta, mesh, load, mechanics, watch)
