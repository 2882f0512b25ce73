"""The compiled rollout of one sample: picks the layout, the cone or window, and hands plain arrays to the kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from physics.cone import GRID_EIGENVALUE, exact_radii, growing_radii, window_radii
from physics.edge_kernel import edge_forward, edge_sensitivity
from physics.grid_kernel import FORWARD_PLANES, specialised
from physics.grid_layout import GridLayout, grid_layout, runs
from physics.mechanics import Mechanics
from physics.mesh import Mesh
from physics.msd_numpy import NORM_GUARD, free_vertices, integrator
from physics.spring_graph import SpringGraph, spring_graph


class Case(NamedTuple):
    """One sample of a batch, as plain arrays."""

    theta: np.ndarray
    """k_s, k_d and signed F, shape [3], float32 or float64: the precision of the computation."""
    mesh: Mesh
    """The mesh at rest."""
    vertex: int
    """Contact vertex."""
    direction: np.ndarray
    """Direction of the force, shape [3]."""
    load: np.ndarray
    """Factor of F in each step, shape [T]."""
    mechanics: Mechanics
    """Constants."""


def require_inside(mesh: Mesh, vertex: int) -> None:
    """Refuse indices that compiled code would follow out of the arrays.

    Raises:
        ValueError: the contact vertex or a spring's end isn't a vertex of the mesh.
    """
    count = len(mesh.vertices)
    if not 0 <= vertex < count:
        raise ValueError(f"vertex is {vertex}; the mesh has {count} vertices.")
    if len(mesh.springs) and not (mesh.springs.min() >= 0 and mesh.springs.max() < count):
        raise ValueError(f"springs join vertices up to {mesh.springs.max()}; the mesh has {count} vertices.")


def contact_rollout(case: Case, sensitive: bool) -> tuple[np.ndarray, np.ndarray]:
    """Displacement of the contact vertex [T, 3] [scene units] and its derivatives by θ [T, 3, 3], or [0, 3, 3] without.

    With ``window_error`` set, a window of the exact cone is computed and compared with a smaller one's trajectory;
    where the two differ by more than the error allowed, the exact cone is computed instead.
    """
    exact = exact_radii(case.mechanics.steps)
    if case.mechanics.window_error > 0:
        used, checked, layout = _window(case)
        if (used < exact).any():
            trajectory, jacobian = _within(case, layout, used, sensitive)
            difference = np.abs(trajectory - _within(case, layout, checked, False)[0]).max()
            if difference <= case.mechanics.window_error * np.abs(trajectory).max():
                return trajectory, jacobian
    return _within(case, _layout(case, exact), exact, sensitive)


def field_rollout(case: Case, field: np.ndarray, begin: int = 0) -> None:
    """Write the displacement of every vertex [scene units] into its place in a batch's field.

    Args:
        case: the sample.
        field: out, shape [T, ΣN, 3], contiguous, of θ's precision.
        begin: first vertex of the sample in it.
    """
    radii = growing_radii(case.mechanics.steps)
    count, dtype = len(case.mesh.vertices), case.theta.dtype
    trajectory, none = np.empty((len(radii), 3), dtype), np.empty((0, 3, 3), dtype)
    free = free_vertices(case.mesh, case.vertex, case.mechanics)
    layout = grid_layout(case.mesh, case.vertex, free, max(case.mesh.grid_shape), dtype)
    if layout is not None:
        where = runs(layout, case.mesh, FORWARD_PLANES)
        _run_grid(case, layout, radii, False, where, trajectory, none, field, begin)
        return
    graph = spring_graph(case.mesh, case.vertex, len(radii), dtype)
    sorted_field = np.empty((len(radii), len(graph.order), 3), dtype)
    _run_edges(case, graph, radii, trajectory, sorted_field)
    own = field[:, begin : begin + count]
    own[:] = 0
    own[:, graph.order] = sorted_field


def numbers(case: Case) -> tuple:
    """k_s, keep, kick, the latter two's slopes by k_d, Δt, anchor, lag, tiny and guard, in the case's precision."""
    mechanics, dtype = case.mechanics, case.theta.dtype
    step = integrator(case.theta[1], mechanics)
    # Twelve digits below one step's impulse nothing is left of single precision. In double, only denormals go.
    impulse = float(step.kick * np.abs(case.theta[2]) * np.abs(case.load).max(initial=0.0))
    tiny = max(1e-12 * impulse, 1e-30) if dtype == np.float32 else 1e-200
    values = (case.theta[0], step.keep, step.kick, step.keep_slope, step.kick_slope, mechanics.time_step)
    return tuple(dtype.type(value) for value in (*values, mechanics.anchor, step.lag, tiny, NORM_GUARD))


def _layout(case: Case, radii: np.ndarray) -> GridLayout | SpringGraph:
    """What lies within reach of steps computed to these radii, shape [T]: as a grid where the mesh is one."""
    reach = int(radii.max())
    free = free_vertices(case.mesh, case.vertex, case.mechanics)
    layout = grid_layout(case.mesh, case.vertex, free, reach + 1, case.theta.dtype)
    return layout or spring_graph(case.mesh, case.vertex, reach, case.theta.dtype)


def _window(case: Case) -> tuple[np.ndarray, np.ndarray, GridLayout | SpringGraph]:
    """Radii of the window to use and of the one to check it with, shapes [T], and what lies within the larger."""
    stiffness, damping, _ = (float(value) for value in case.theta)
    used, checked = window_radii(stiffness, damping, case.mechanics, GRID_EIGENVALUE)
    layout = _layout(case, used)
    if isinstance(layout, SpringGraph) and len(case.mesh.springs):
        # Two neighbours' degrees together bound the eigenvalues of any graph's Laplacian.
        degree = np.bincount(case.mesh.springs.ravel(), minlength=len(case.mesh.vertices))
        eigenvalue = float(degree[case.mesh.springs].sum(axis=1).max())
        used, checked = window_radii(stiffness, damping, case.mechanics, eigenvalue)
        layout = _layout(case, used)
    return used, checked, layout


def _within(case: Case, layout: GridLayout | SpringGraph, radii: np.ndarray, sensitive: bool):
    """Trajectory [T, 3] and Jacobian [T or 0, 3, 3], computing each step within a radius, shape [T]."""
    dtype, steps = case.theta.dtype, len(radii)
    trajectory = np.empty((steps, 3), dtype)
    jacobian = np.empty((steps if sensitive else 0, 3, 3), dtype)
    if isinstance(layout, GridLayout):
        nowhere, nothing = np.empty((0, 3), np.int64), np.empty((steps, 0, 3), dtype)
        _run_grid(case, layout, radii, sensitive, nowhere, trajectory, jacobian, nothing)
    elif sensitive:
        free = free_vertices(case.mesh, case.vertex, case.mechanics)
        edge_sensitivity(
            layout.springs,
            layout.rest,
            layout.length,
            free[layout.order].astype(dtype),
            *layout.prefixes(radii),
            case.load.astype(dtype),
            np.asarray(case.direction, dtype),
            case.theta[2],
            numbers(case),
            trajectory,
            jacobian,
        )
    else:
        _run_edges(case, layout, radii, trajectory, np.empty((0, len(layout.order), 3), dtype))
    return trajectory, jacobian


def _run_grid(
    case: Case, layout: GridLayout, radii, sensitive: bool, where, trajectory, jacobian, field, begin: int = 0
) -> None:
    """Call the grid kernel, which fills trajectory, jacobian and field from `begin` on."""
    dtype = case.theta.dtype
    specialised(layout.pitch, sensitive)(
        layout.rest,
        layout.first,
        layout.last,
        layout.contact,
        radii,
        case.load.astype(dtype),
        np.asarray(case.direction, dtype),
        case.theta[2],
        numbers(case),
        where,
        trajectory,
        jacobian,
        field,
        begin,
    )


def _run_edges(case: Case, graph: SpringGraph, radii: np.ndarray, trajectory, field) -> None:
    """Call the edge kernel with uniform parameters; the last two arrays are filled."""
    dtype, count = case.theta.dtype, len(graph.order)
    stiffness, keep, kick, _, _, time_step, anchor, lag, tiny, guard = numbers(case)
    allowed = free_vertices(case.mesh, case.vertex, case.mechanics)[graph.order].astype(dtype)
    edge_forward(
        graph.springs,
        graph.rest,
        graph.length,
        np.full(len(graph.springs), stiffness, dtype),
        np.full(count, anchor * stiffness, dtype),
        keep * allowed,
        kick * allowed,
        *graph.prefixes(radii),
        case.load.astype(dtype),
        case.theta[2] * np.asarray(case.direction, dtype),
        (time_step, lag, tiny, guard),
        trajectory,
        np.empty((0, count, 3), dtype),
        field,
    )
