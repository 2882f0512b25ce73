"""The compiled rollout of one sample: picks the layout, the cone or window, and hands plain arrays to the kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from physics.load import Grip, Load, Press
from physics.mechanics import Mechanics
from physics.mesh import Mesh
from physics.msd.cone import GRID_EIGENVALUE, Reach, exact_radii, growing_radii, window_radii
from physics.msd.edge_kernel import Tissue, edge_forward, edge_sensitivity
from physics.msd.grid_kernel import FORWARD_PLANES, SENSITIVITY_PLANES, specialised
from physics.msd.grid_layout import GridLayout, grid_layout, places, runs
from physics.msd.reference import NORM_GUARD, Acting, acting, free_vertices, integrator
from physics.msd.spring_graph import SpringGraph, spring_graph


class Case(NamedTuple):
    """One sample of a batch, as plain arrays."""

    theta: np.ndarray
    """k_s, k_d and signed F, shape [3], float32 or float64: the precision of the computation."""
    mesh: Mesh
    """The mesh at rest."""
    load: Load
    """What acts on it."""
    mechanics: Mechanics
    """Constants."""
    watch: np.ndarray
    """Vertices whose displacement is wanted, shape [M], int64."""


class Watched(NamedTuple):
    """What one rollout tells."""

    path: np.ndarray
    """Displacement of the watched vertices, shape [T, M, 3] [scene units]."""
    slopes: np.ndarray
    """Its derivatives by θ, shape [T, M, 3, 3], or [0, M, 3, 3]."""
    elastic: np.ndarray
    """Force of the springs on the gripped vertices, shape [T, G, 3], or [0, G, 3] without derivatives."""
    elastic_slopes: np.ndarray
    """Its derivatives by θ, shape [T, G, 3, 3], or [0, G, 3, 3]."""


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


def watched_rollout(case: Case, sensitive: bool) -> Watched:
    """Motion of the watched vertices, with derivatives by θ where they are wanted.

    With ``window_error`` set, a window of the exact cone is computed and compared with a smaller one's trajectory;
    where the two differ by more than the error allowed, the exact cone is computed instead.
    """
    if case.mechanics.window_error > 0:
        layout, (used, checked, whole) = _layout(case, windowed=True)
        if (used < whole).any():
            found = _within(case, layout, used, sensitive)
            difference = np.abs(found.path - _within(case, layout, checked, False).path).max()
            # Two windows that both end before a watched vertex agree on 0, which tells nothing.
            if difference < case.mechanics.window_error * np.abs(found.path).max():
                return found
    layout, (whole, _, _) = _layout(case, windowed=False)
    return _within(case, layout, whole, sensitive)


def field_rollout(case: Case, field: np.ndarray, begin: int = 0) -> None:
    """Write the displacement of every vertex [scene units] into its place in a batch's field.

    Args:
        case: the sample.
        field: out, shape [T, ΣN, 3], contiguous, of θ's precision.
        begin: first vertex of the sample in it.
    """
    steps, dtype = case.load.steps, case.theta.dtype
    own = field[:, begin : begin + len(case.mesh.vertices)]
    layout = grid_layout(case.mesh, case.load.vertex, _movable(case), max(case.mesh.grid_shape), dtype)
    if layout is not None:
        where = runs(layout, case.mesh, FORWARD_PLANES)
        reach = _grid_reach(case)
        _run_grid(case, layout, growing_radii(steps, reach), where, _room(case, False), field, begin)
    else:
        whole = case._replace(watch=np.arange(len(case.mesh.vertices)))
        graph = spring_graph(case.mesh, case.load.vertices, whole.watch, steps + 1, dtype)
        own[:] = _within(whole, graph, growing_radii(steps, Reach(gripped=isinstance(case.load, Grip))), False).path
    if isinstance(case.load, Grip):
        own[:, case.load.vertices] = case.load.displacement


def numbers(case: Case) -> tuple:
    """k_s, keep, kick, the latter two's slopes by k_d, Δt, anchor, lag, tiny and guard, in the case's precision."""
    mechanics, dtype = case.mechanics, case.theta.dtype
    step = integrator(case.theta[1], mechanics)
    # Twelve digits below one step's impulse nothing is left of single precision. In double, only denormals go.
    if isinstance(case.load, Press):
        impulse = float(step.kick * np.abs(case.theta[2]) * np.abs(case.load.factor).max(initial=0.0))
    else:
        impulse = float(np.abs(case.load.displacement).max() / mechanics.time_step)
    tiny = max(1e-12 * impulse, 1e-30) if dtype == np.float32 else 1e-200
    values = (case.theta[0], step.keep, step.kick, step.keep_slope, step.kick_slope, mechanics.time_step)
    return tuple(dtype.type(value) for value in (*values, mechanics.anchor, step.lag, tiny, NORM_GUARD))


def placed(load: Acting, graph: SpringGraph) -> Acting:
    """The same with its vertices' positions in a graph."""
    return load._replace(pressed=graph.position[load.pressed], gripped=graph.position[load.gripped])


def _movable(case: Case) -> np.ndarray:
    """Vertices that a grid's kernel moves, shape [N], bool: gripped ones too, which it puts back where they belong."""
    free = free_vertices(case.mesh, case.load, case.mechanics)
    free[case.load.vertices] = True
    return free


def _grid_reach(case: Case) -> Reach:
    """How far loaded and watched vertices lie from the load's first one on the grid (see `grid_kernel`)."""

    def farthest(vertices: np.ndarray) -> int:
        rows, columns = (case.mesh.pixels[vertices].astype(np.int64) - case.mesh.pixels[case.load.vertex]).T
        return int(np.abs([rows, columns, rows - columns]).max())

    return Reach(farthest(case.load.vertices), farthest(case.watch), isinstance(case.load, Grip))


def graph_reach(case: Case, graph: SpringGraph) -> Reach:
    """The same where distances count from all loaded vertices; what springs don't reach never moves."""
    levels = np.searchsorted(graph.vertex_count, graph.position[case.watch], side="right")
    connected = levels[levels < len(graph.vertex_count)]
    return Reach(0, int(connected.max(initial=0)), isinstance(case.load, Grip))


def _layout(case: Case, windowed: bool) -> tuple[GridLayout | SpringGraph, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """What lies within reach, as a grid where the mesh is one, and `_radii`."""
    dtype, reach = case.theta.dtype, _grid_reach(case)
    radii = _radii(case, reach, GRID_EIGENVALUE, windowed)
    far = max(int(radii[0].max()) + 1, reach.loaded, reach.watched)
    layout = grid_layout(case.mesh, case.load.vertex, _movable(case), far, dtype)
    if layout is not None:
        return layout, radii
    # Springs from every watched vertex to the load: no more than there are steps matter.
    graph = spring_graph(case.mesh, case.load.vertices, case.watch, case.load.steps + 1, dtype)
    return graph, _radii(case, graph_reach(case, graph), _eigenvalue(case.mesh), windowed)


def _radii(case: Case, reach: Reach, eigenvalue: float, windowed: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How far each step is computed, [T]: in a window, in a smaller one to check it with, and in the exact cone.

    All three are the cone if no window is wanted.
    """
    exact = exact_radii(case.load.steps, reach)
    if not windowed:
        return exact, exact, exact
    stiffness, damping, _ = (float(value) for value in case.theta)
    return *window_radii(stiffness, damping, case.mechanics, eigenvalue, case.load.steps, reach), exact


def _eigenvalue(mesh: Mesh) -> float:
    """Bound on the eigenvalues of the springs' graph Laplacian: the degrees of two neighbours together."""
    degree = np.bincount(mesh.springs.ravel(), minlength=len(mesh.vertices))
    return float(degree[mesh.springs].sum(axis=1).max(initial=1))


def _room(case: Case, sensitive: bool) -> Watched:
    """Arrays for the kernels to fill."""
    steps, watched = case.load.steps, len(case.watch)
    carried = steps if sensitive else 0
    gripped = len(case.load.vertices) if isinstance(case.load, Grip) else 0
    shapes = (steps, watched, 3), (carried, watched, 3, 3), (carried, gripped, 3), (carried, gripped, 3, 3)
    return Watched(*(np.zeros(shape, case.theta.dtype) for shape in shapes))


def _within(case: Case, layout: GridLayout | SpringGraph, radii: np.ndarray, sensitive: bool) -> Watched:
    """Motion of the watched vertices, computing each step within a radius, shape [T]."""
    out = _room(case, sensitive)
    if isinstance(layout, GridLayout):
        _run_grid(case, layout, radii, np.empty((0, 3), np.int64), out, np.empty((0, 0, 3), case.theta.dtype))
    else:
        _run_edges(case, layout, radii, out)
    out.slopes[:, put_gripped(case, out.path)] = 0
    return out


def put_gripped(case: Case, path: np.ndarray) -> np.ndarray:
    """Put gripped vertices into a path [T, M, 3] where they are held; indices of those among the M."""
    if isinstance(case.load, Press):
        return np.empty(0, np.int64)
    watched, gripped = np.nonzero(case.watch[:, None] == case.load.vertices)
    path[:, watched] = case.load.displacement[:, gripped]
    return watched


def _run_grid(case: Case, layout: GridLayout, radii, where, out: Watched, field, begin: int = 0) -> None:
    """Call the grid kernel, which fills `out` and the field from `begin` on."""
    dtype, sensitive = case.theta.dtype, len(out.slopes) > 0
    planes = SENSITIVITY_PLANES if sensitive else FORWARD_PLANES
    load = acting(case.load, case.mechanics, dtype)
    inside = (places(layout, case.mesh, vertices, planes) for vertices in (load.pressed, load.gripped, case.watch))
    pressed, gripped, watched = inside
    load, rollout = load._replace(pressed=pressed, gripped=gripped), specialised(layout.pitch, sensitive)
    rollout(layout, radii, load, watched, case.theta[2], numbers(case), where, out, field, begin)


def _run_edges(case: Case, graph: SpringGraph, radii: np.ndarray, out: Watched) -> None:
    """Call the edge kernel with or without derivatives, which fills `out`."""
    dtype = case.theta.dtype
    free = free_vertices(case.mesh, case.load, case.mechanics)[graph.order].astype(dtype)
    load = placed(acting(case.load, case.mechanics, dtype), graph)
    within, watched = graph.prefixes(radii), graph.position[case.watch]
    force, values = case.theta[2], numbers(case)
    if len(out.slopes):
        edge_sensitivity(graph, *within, free, load, watched, force, values, out)
        return
    stiffness, keep, kick, _, _, time_step, anchor, lag, tiny, guard = values
    pull, hold = np.full(len(graph.springs), stiffness, dtype), np.full(len(free), anchor * stiffness, dtype)
    tissue, load = Tissue(pull, hold, keep * free, kick * free), load._replace(push=force * load.push)
    speeds = np.empty((0, len(free), 3), dtype)
    edge_forward(graph, *within, tissue, load, watched, (time_step, lag, tiny, guard), out.path, speeds)
