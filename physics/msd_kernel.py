"""Forward simulation: numpy in, numpy out, no torch; compiled where numba is installed.

Source: Bini 2026, section 3.4.4 (forward simulation with the estimated parameters) and equation 9.
"""

from __future__ import annotations

import numpy as np

from physics import jit, msd_compiled, msd_numpy
from physics.mechanics import Mechanics
from physics.mesh import Mesh
from physics.msd_compiled import Case


def simulate(
    theta: np.ndarray,
    mesh: Mesh,
    vertex: int,
    direction: np.ndarray,
    mechanics: Mechanics,
    *,
    load_steps: int | None = None,
    load: np.ndarray | None = None,
    dtype: type = np.float32,
) -> np.ndarray:
    """Displacement of the contact vertex after each step.

    Args:
        theta: k_s, k_d and signed F, shape [3] [normalised].
        mesh: the mesh at rest.
        vertex: contact vertex, on which F·direction acts; never held.
        direction: unit vector of the force, shape [3].
        mechanics: constants.
        load_steps: steps under load from the start, instead of ``mechanics.load_steps``.
        load: factor of F in each step, shape [T], instead of ``load_steps``.
        dtype: float32 or float64, the precision of the computation.

    Returns:
        Shape [T, 3] [scene units]; index i is the time (i+1)·Δt.

    Raises:
        ValueError: a shape, an index or a value that makes no sense.
    """
    case = _case(theta, mesh, vertex, direction, mechanics, load_steps, load, dtype)
    if jit.COMPILED:
        return msd_compiled.contact_rollout(case, sensitive=False)[0]
    jit.say_slow()
    return np.stack([field[vertex] for field in msd_numpy.steps(*_plain(case))])


def simulate_sensitivities(
    theta: np.ndarray,
    mesh: Mesh,
    vertex: int,
    direction: np.ndarray,
    mechanics: Mechanics,
    *,
    load_steps: int | None = None,
    load: np.ndarray | None = None,
    dtype: type = np.float32,
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement of the contact vertex [T, 3] and its exact derivatives by k_s, k_d and F [T, 3, 3], in one pass.

    Arguments and errors as in `simulate`; the last axis of the derivatives is θ's.
    """
    case = _case(theta, mesh, vertex, direction, mechanics, load_steps, load, dtype)
    if jit.COMPILED:
        return msd_compiled.contact_rollout(case, sensitive=True)
    jit.say_slow()
    return msd_numpy.sensitivities(*_plain(case))


def simulate_field(
    theta: np.ndarray,
    mesh: Mesh,
    vertex: int,
    direction: np.ndarray,
    mechanics: Mechanics,
    *,
    load_steps: int | None = None,
    load: np.ndarray | None = None,
    dtype: type = np.float32,
) -> np.ndarray:
    """Displacement of every vertex after each step, shape [T, N, 3] [scene units]; arguments as in `simulate`."""
    case = _case(theta, mesh, vertex, direction, mechanics, load_steps, load, dtype)
    if jit.COMPILED:
        field = np.empty((mechanics.steps, len(mesh.vertices), 3), dtype)
        msd_compiled.field_rollout(case, field)
        return field
    jit.say_slow()
    return np.stack(list(msd_numpy.steps(*_plain(case))))


def load_profile(mechanics: Mechanics, load_steps: int | None = None, load: np.ndarray | None = None) -> np.ndarray:
    """Factor of F in each step, shape [T], float64.

    Raises:
        ValueError: ``load`` has another shape or isn't finite, or ``load_steps`` lies outside 0 to T.
    """
    if load is not None:
        load = np.asarray(load, dtype=np.float64)
        if load.shape != (mechanics.steps,) or not np.isfinite(load).all():
            raise ValueError(f"load has shape {load.shape}; give {mechanics.steps} finite factors, one a step.")
        return load
    count = mechanics.load_steps if load_steps is None else int(load_steps)
    if not 0 <= count <= mechanics.steps:
        raise ValueError(f"load_steps is {count}; give 0 to {mechanics.steps} (mechanics.steps).")
    return (np.arange(mechanics.steps) < count).astype(np.float64)


def _plain(case: Case) -> tuple:
    """A case in the order of `msd_numpy`'s arguments."""
    return case.theta, case.mesh, case.vertex, case.direction, case.mechanics, case.load


def _case(theta, mesh, vertex, direction, mechanics, load_steps, load, dtype) -> Case:
    """The arguments as one checked case, or a ValueError that says what is wrong."""
    theta = np.asarray(theta, dtype=dtype)
    if theta.shape != (3,) or not np.isfinite(theta).all():
        raise ValueError(f"theta is {theta.tolist()}; give three finite numbers k_s, k_d and F.")
    if theta[0] < 0 or theta[1] < 0:
        raise ValueError(f"theta has k_s = {theta[0]:g} and k_d = {theta[1]:g}; neither may be negative.")
    if np.shape(direction) != (3,) or not np.isfinite(direction).all():
        raise ValueError(f"direction is {direction}; give three finite numbers.")
    msd_compiled.require_inside(mesh, vertex)
    profile = load_profile(mechanics, load_steps, load)
    return Case(theta, mesh, int(vertex), np.asarray(direction), profile, mechanics)
