"""Forward simulation: numpy in, numpy out, no torch; presses on grid meshes are compiled.

Source: Bini 2026, section 3.4.4 (forward simulation with the estimated parameters) and equation 9.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from palpate.physics.identifiability import log_jacobian
from palpate.physics.load import Load, Press
from palpate.physics.mechanics import Mechanics
from palpate.physics.mesh import NORM_GUARD, Mesh
from palpate.physics.msd import grid_kernel, reference
from palpate.physics.msd.cone import DERIVATIVES, Reach, exact_radii, window_radii
from palpate.physics.msd.grid_layout import GridLayout, grid_layout, places

Watch = np.ndarray | None
"""Vertices whose displacement is wanted, or the load's first one."""


def simulate(
    theta: ArrayLike, mesh: Mesh, load: Load, mechanics: Mechanics, *, watch: Watch = None, dtype: type = np.float32
) -> np.ndarray:
    """Displacement of a few vertices after each step.

    Args:
        theta: k_s, k_d and signed F, shape [3] [normalised]; F means nothing under a grip.
        mesh: the mesh at rest.
        load: load on the mesh; its number of steps T is the simulation's.
        mechanics: constants.
        watch: vertices, shape [M]; None = the load's first one.
        dtype: float32 or float64, the precision of the computation.

    Returns:
        Shape [T, M, 3], or [T, 3] without `watch` [scene units]; index i is the time (i+1)·Δt.

    Raises:
        ValueError: a shape, an index or a value that makes no sense.
    """
    path, _ = watched_rollout(_case(theta, mesh, load, mechanics, watch, dtype), sensitive=False)
    return path[:, 0] if watch is None else path


def simulate_sensitivities(
    theta: ArrayLike, mesh: Mesh, load: Load, mechanics: Mechanics, *, watch: Watch = None, dtype: type = np.float32
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement [T, M, 3] and its exact derivatives by k_s, k_d and F [T, M, 3, 3], in one pass.

    Arguments and errors as in `simulate`; without `watch` the second axis is left out. The last axis is θ's.
    """
    path, slopes = watched_rollout(_case(theta, mesh, load, mechanics, watch, dtype), sensitive=True)
    return (path[:, 0], slopes[:, 0]) if watch is None else (path, slopes)


def simulate_tangent(theta: ArrayLike, mesh: Mesh, load: Load, mechanics: Mechanics, **how) -> tuple[np.ndarray, ...]:
    """Result of `simulate_sensitivities`, with the derivatives by φ = (log k_s, log k_d, log |F|) in place of θ.

    They are 0 where the motion is so chaotic that rounding decides them.
    """
    path, slopes = simulate_sensitivities(theta, mesh, load, mechanics, **how)
    slopes = log_jacobian(slopes, theta)
    return path, np.zeros_like(slopes) if is_chaotic(path, slopes) else slopes


def is_chaotic(path: np.ndarray, log_slopes: np.ndarray) -> bool:
    """Return whether rounding decides a motion's derivatives by φ, so large are they; shapes [T, …] and [T, …, D]."""
    # Measured in single precision on a 14,800-vertex mesh: below 20 they agree with double precision to 1 %, at 100 to
    # 10 %.
    limit = 100.0 if path.dtype == np.float32 else 1e8
    return bool(np.abs(log_slopes).max(initial=0) > limit * np.abs(path).max(initial=0))


class Case(NamedTuple):
    """One simulation, as plain arrays."""

    theta: np.ndarray
    """k_s, k_d and signed F, shape [3], float32 or float64: the precision of the computation."""
    mesh: Mesh
    """The mesh at rest."""
    load: Load
    """Load that acts on it."""
    mechanics: Mechanics
    """Constants."""
    watch: np.ndarray
    """Vertices whose displacement is wanted, shape [M], int64."""


def require_inside(mesh: Mesh, load: Load, watch: np.ndarray) -> None:
    """Refuse indices that compiled code would follow out of the arrays.

    Raises:
        ValueError: a loaded or watched vertex, or a spring's end, isn't a vertex of the mesh.
    """
    count = len(mesh.vertices)
    for name, vertices in (("load", load.vertices), ("watch", watch)):
        if len(vertices) and not (vertices.min() >= 0 and vertices.max() < count):
            outside = vertices[(vertices < 0) | (vertices >= count)][0]
            raise ValueError(f"{name} names vertex {outside}; the mesh has {count} vertices.")
    if len(mesh.springs) and not (mesh.springs.min() >= 0 and mesh.springs.max() < count):
        raise ValueError(f"springs join vertices up to {mesh.springs.max()}; the mesh has {count} vertices.")


def watched_rollout(case: Case, sensitive: bool) -> tuple[np.ndarray, np.ndarray]:
    """Motion of the watched vertices [T, M, 3] and, where they are wanted, its derivatives by θ [T, M, 3, 3].

    Grips, decimated meshes and other cases without a compiled stencil run in the plain version.
    """
    if isinstance(case.load, Press):
        found = _on_grid(case, case.load, sensitive)
        if found is not None:
            return found
    steps = reference.steps(*case[:4], sensitive=sensitive)
    found = [(moved[case.watch], np.moveaxis(slopes[:, case.watch], 0, -1)) for moved, slopes in steps]
    path, slopes = (np.stack(values) for values in zip(*found, strict=True))
    return path, slopes if sensitive else slopes[:0]


def _on_grid(case: Case, press: Press, sensitive: bool) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the rollout, compiled; None where the mesh is no grid.

    With ``window_error`` set, a window of the exact cone is computed and compared with a smaller one's trajectory. If
    the two differ by more than the error allowed, the exact cone is computed instead.
    """
    mechanics, (stiffness, damping, _) = case.mechanics, (float(value) for value in case.theta)
    reach = Reach(_farthest(case, press.vertices), _farthest(case, case.watch))
    whole = exact_radii(press.steps, reach)
    if mechanics.window_error > 0:
        used, checked = window_radii(stiffness, damping, mechanics, press.steps, reach)
        if (used < whole).any():
            layout = _layout(case, reach, used)
            if layout is None:
                return None
            found = _within(case, press, layout, used, sensitive)
            difference = np.abs(found[0] - _within(case, press, layout, checked, False)[0]).max()
            limit = mechanics.window_error * (DERIVATIVES if sensitive else 1.0)
            # Two windows that both end before a watched vertex agree on 0, which tells nothing.
            if difference < limit * np.abs(found[0]).max():
                return found
    layout = _layout(case, reach, whole)
    return None if layout is None else _within(case, press, layout, whole, sensitive)


def _farthest(case: Case, vertices: np.ndarray) -> int:
    """Largest distance of vertices from the load's first one on the grid (see `grid_kernel`)."""
    rows, columns = (case.mesh.pixels[vertices].astype(np.int64) - case.mesh.pixels[case.load.vertex]).T
    return int(np.abs([rows, columns, rows - columns]).max())


def _layout(case: Case, reach: Reach, radii: np.ndarray) -> GridLayout | None:
    """Window within reach; None where the mesh is no grid."""
    return grid_layout(case.mesh, case.load.vertices, max(int(radii.max()), *reach), case.theta.dtype)


def _within(
    case: Case, press: Press, layout: GridLayout, radii: np.ndarray, sensitive: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Motion of the watched vertices, and its derivatives where wanted, computing each step within a radius, [T]."""
    dtype, (steps, watched) = case.theta.dtype, (press.steps, len(case.watch))
    path, slopes = np.zeros((steps, watched, 3), dtype), np.zeros((steps if sensitive else 0, watched, 3, 3), dtype)
    planes = grid_kernel.SENSITIVITY_PLANES if sensitive else grid_kernel.FORWARD_PLANES
    pressed, shown = (places(layout, case.mesh, each, planes) for each in (press.vertices, case.watch))
    load = press.factor.astype(dtype), pressed, reference.push_of(press, dtype)
    rollout = grid_kernel.specialised(layout.pitch, sensitive)
    rollout(layout, radii, load, shown, case.theta[2], _numbers(case, press), path, slopes)
    return path, slopes


def _numbers(case: Case, press: Press) -> tuple:
    """k_s, keep, kick, the latter two's slopes by k_d, Δt, lag, tiny and guard, in the case's precision."""
    mechanics, dtype = case.mechanics, case.theta.dtype
    step = reference.integrator(case.theta[1], mechanics)
    # Twelve digits below one step's impulse nothing is left of single precision. In double, only denormals go.
    impulse = float(step.kick * np.abs(case.theta[2]) * np.abs(press.factor).max(initial=0.0))
    tiny = max(1e-12 * impulse, 1e-30) if dtype == np.float32 else 1e-200
    values = (case.theta[0], step.keep, step.kick, step.keep_slope, step.kick_slope, mechanics.time_step)
    return tuple(dtype.type(value) for value in (*values, step.lag, tiny, NORM_GUARD))


def _case(theta, mesh, load, mechanics, watch, dtype) -> Case:
    """The arguments as one checked case, or a ValueError with the reason."""
    theta = np.asarray(theta, dtype=dtype)
    if theta.shape != (3,) or not np.isfinite(theta).all():
        raise ValueError(f"theta is {theta.tolist()}; give three finite numbers k_s, k_d and F.")
    if theta[0] < 0 or theta[1] < 0:
        raise ValueError(f"theta has k_s = {theta[0]:g} and k_d = {theta[1]:g}; neither may be negative.")
    watch = np.asarray(load.vertices[:1] if watch is None else watch)
    if watch.ndim != 1 or watch.size == 0 or watch.dtype.kind not in "iu":
        raise ValueError(f"watch has shape {watch.shape} and type {watch.dtype}; give [M] indices, one at least.")
    watch = watch.astype(np.int64)
    require_inside(mesh, load, watch)
    return Case(theta, mesh, load, mechanics, watch)
