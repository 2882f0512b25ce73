"""Pulls with ground truth: two sheets by a fine mass-spring net, two blocks by finite elements.

They stand in for the paper's chicken skin and muscle (Liang 2024, section III-A: pinned at one side, pulled by a
gripper). Both creep: they flow down their energy against drag, without inertia, as the estimator's steps without
velocities do. Sheets are nets of springs along rows, both diagonals and, against bending, every second node; blocks
are neo-Hookean finite elements, in implicit steps. The estimator's particles lie elsewhere, and in another number.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.sparse import csr_array, diags_array

from palpate.estimators.online.knots import farthest
from palpate.estimators.online.objective import Chamfer, Match, Tracks
from palpate.physics.fem.equilibrium import Energy, settle
from palpate.physics.fem.laws import Material
from palpate.physics.fem.meshing import box
from palpate.physics.fem.solid import make_solid, outer_faces
from palpate.physics.mesh import grid_springs, holding, incidence
from palpate.physics.pbd.body import Body, make_body

SIDE = 0.12
"""Side of a sheet [m]."""
BLOCK = (0.10, 0.08, 0.02)
"""Sides of a block [m]: 2 cm thick, as the paper's."""
FINE, FINE_CELLS = 41, (16, 13, 4)
"""Nodes along a sheet's side; cells of a block."""
STIFF = 3.0
"""Stiffness of the stiff part, over the soft one."""
NOISE, KEYPOINTS = 0.2e-3, 15
"""Standard deviation of observations by axis [m]; number of keypoints among the tracks (section III-D)."""

State = Callable[[np.ndarray], np.ndarray]
"""Displacement [m] of places at rest [P, 3], shape [P, 3]."""


@dataclass(frozen=True, eq=False)
class Pull:
    """One simulated sequence and its observations; N particles, T frames, m points, P followed ones."""

    body: Body
    gripped: np.ndarray
    """Particles, shape [G]."""
    visible: np.ndarray
    """Particles that the camera sees, shape [n]: all of a sheet's, a block's upper side."""
    places: np.ndarray
    """Places of the gripper, shape [T, G, 3] [m]."""
    clouds: np.ndarray
    """Points of the surface, shape [T, m, 3] [m]."""
    shares: csr_array
    """Shares of the particles in each tracked point, shape [P, N]."""
    tracks: np.ndarray
    """Observed places of tracked points, shape [T, P, 3] [m]."""
    points: np.ndarray
    """True places of tracked points, at rest and in every frame, shape [T + 1, P, 3] [m]."""
    keypoints: np.ndarray
    """Indices of the keypoints, shape [15]."""
    stiffness: np.ndarray
    """True relative stiffness at the particles, shape [N]."""
    truth: np.ndarray
    """True places of the particles, shape [T, N, 3] [m]."""

    def matches(self, frame: int, kind: str) -> list[Match]:
        """Observations that the estimator is given of a frame: `chamfer`, `tracks` or `both`."""
        found: list[Match] = []
        if kind != "tracks":
            found.append(Chamfer(self.clouds[frame], self.visible))
        if kind != "chamfer":
            found.append(Tracks(self.shares, self.tracks[frame]))
        return found

    def moving(self) -> np.ndarray:
        """Free particles with an edge whose length changes by more than a hundredth at some time, shape [N], bool."""
        strained = (np.abs(self.body.strains(self.truth)) > 0.01).any(axis=0)
        moving = np.isin(np.arange(self.body.count), self.body.edges[strained])
        return moving & (self.body.inverse_mass(self.gripped) > 0)


@dataclass(frozen=True)
class Sequence:
    """One of the four, as it is asked for."""

    block: bool
    frames: int
    """Number of frames."""
    way: Callable[[np.ndarray], np.ndarray]
    """Displacement of the gripper at shares of the time [S], shape [S, 3] [m]."""
    stiff: Callable[[np.ndarray], np.ndarray]
    """Mask of stiff places at rest [P, 3], bool [P]."""

    def pull(self, particles: int, points: int, frames: int) -> Pull:
        """Simulate and observe; always the same.

        Args:
            particles: about how many the estimator has.
            points: number of points of a cloud.
            frames: number of frames from the beginning.
        """
        path = self.way(np.arange(1, frames + 1) / self.frames)
        states = (_block_states if self.block else _sheet_states)(path, self.stiff)
        body = _block_body(particles) if self.block else _sheet_body(particles)
        random = np.random.default_rng(0)
        top = BLOCK[2] if self.block else 0.0
        visible = np.flatnonzero(body.rest[:, 2] > top - 1e-9)
        gripped = np.flatnonzero(_held(body.rest, self.block))

        def surface(count: int) -> np.ndarray:
            size = BLOCK[:2] if self.block else (SIDE, SIDE)
            return np.column_stack([random.uniform(0, 1, (count, 2)) * size, np.full(count, top)])

        followed = surface(200)
        true = np.stack([followed, *(followed + state(followed) for state in states)])
        clouds = []
        for state in states:
            cloud = surface(points)
            clouds.append(cloud + state(cloud) + random.normal(0, NOISE, cloud.shape))
        tracks = _shares(body, visible, followed), true[1:] + random.normal(0, NOISE, true[1:].shape), true
        truth = np.stack([body.rest + state(body.rest) for state in states])
        observed = body.rest[gripped] + path[:, None], np.stack(clouds), *tracks, _spread_out(true)
        return Pull(body, gripped, visible, *observed, np.where(self.stiff(body.rest), STIFF, 1.0), truth)


def _held(rest: np.ndarray, block: bool) -> np.ndarray:
    """Places that the gripper holds: around the middle of the side opposite the pins, of a block on its upper side."""
    size = BLOCK if block else (SIDE, SIDE, 0.0)
    # Radius of what the gripper holds [m].
    return np.linalg.norm(rest - (size[0], size[1] / 2, size[2]), axis=1) < 0.012


def _grid(columns: int, rows: int, size: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Places [N, 3] of a flat grid, and the numbers of its nodes [columns, rows]."""
    along = np.meshgrid(np.linspace(0, size[0], columns), np.linspace(0, size[1], rows), indexing="ij")
    places = np.stack([*along, np.zeros((columns, rows))], axis=-1).reshape(-1, 3)
    return places, np.arange(columns * rows).reshape(columns, rows)


def _sheet_body(particles: int) -> Body:
    """Body of triangles whose diagonals alternate, pinned at x = 0."""
    side = max(round(particles**0.5), 6)
    rest, at = _grid(side, side, (SIDE, SIDE))
    one, two, three, four = (part.ravel() for part in (at[:-1, :-1], at[1:, :-1], at[:-1, 1:], at[1:, 1:]))
    odd = ((one // side + one % side) % 2 == 1)[:, None]
    first = np.where(odd, np.column_stack([one, two, three]), np.column_stack([one, two, four]))
    second = np.where(odd, np.column_stack([two, four, three]), np.column_stack([one, four, three]))
    return make_body(rest, np.concatenate([first, second]), pinned=rest[:, 0] < 1e-9)


def _block_body(particles: int) -> Body:
    """Body of cubes of five tetrahedra each, pinned at x = 0."""
    sizes = [[max(round(side / step), 2) for side in BLOCK] for step in np.linspace(0.004, 0.03, 200)]
    along, across, deep = min(sizes, key=lambda cells: abs(np.prod(np.array(cells) + 1) - particles))
    rest, tetrahedra = box(BLOCK, (along, across, deep))
    return make_body(rest, outer_faces(tetrahedra), tetrahedra, pinned=rest[:, 0] < 1e-9)


def _interpolated(axes: tuple[np.ndarray, ...], values: np.ndarray) -> State:
    """Displacement between the nodes of a grid of two or three axes."""
    field = RegularGridInterpolator(axes, values, bounds_error=False, fill_value=None)
    return lambda places: field(places[:, : len(axes)])


def _sheet_states(path: np.ndarray, stiff: Callable[[np.ndarray], np.ndarray]) -> list[State]:
    """States of a net that flows down its energy, in stable steps of Euler's."""
    rest, _ = _grid(FINE, FINE, (SIDE, SIDE))
    # Nodes to the right and up, and stiffness over that of rows: along rows, along diagonals, and against bending.
    net = ((1, 0, 1.0), (0, 1, 1.0), (1, 1, 0.5), (1, -1, 0.5), (2, 0, 0.05), (0, 2, 0.05))
    kinds = [grid_springs((FINE, FINE), right, up) for right, up, _ in net]
    springs, relative = np.concatenate(kinds), np.where(stiff(rest), STIFF, 1.0)
    first, second = springs.T
    weights = np.repeat([weight for *_, weight in net], [len(kind) for kind in kinds])
    stiffness = weights * (relative[first] + relative[second]) / 2
    lengths = np.linalg.norm(rest[first] - rest[second], axis=1)
    ends = incidence(springs, len(rest))
    # Drag over the stiffness of soft springs [frames/m²]: 1 a particle, 5 mm apart.
    drag = 1 / 0.005**2 * (SIDE / (FINE - 1)) ** 2
    held = _held(rest, False)
    fixed = (held | (rest[:, 0] < 1e-9))[:, None]
    # A node's springs pull at most twice their sum as fast as it moves: half of the stable limit.
    steps = int(np.ceil(2 * float(np.bincount(np.r_[first, second], np.tile(stiffness, 2)).max()) / drag))
    now, before, states = rest.copy(), np.zeros(3), []
    axis = np.linspace(0, SIDE, FINE)
    for after in path:
        for step in range(1, steps + 1):
            apart = now[first] - now[second]
            length = np.linalg.norm(apart, axis=1)
            force = ends @ ((stiffness * (1 - lengths / length))[:, None] * apart)
            now = now - np.where(fixed, 0.0, force / (drag * steps))
            now[held] = rest[held] + before + step / steps * (after - before)
        before = after
        states.append(_interpolated((axis, axis), (now - rest).reshape(FINE, FINE, 3)))
    return states


def _block_states(
    path: np.ndarray, stiff: Callable[[np.ndarray], np.ndarray], young: float = 5e3, count: int = 2
) -> list[State]:
    """States of a neo-Hookean block that creeps: Euler's implicit steps, each the least of energy and drag's work.

    Args:
        path: displacement of the gripper, shape [T, 3] [m].
        stiff: mask of stiff places, as in `Sequence`.
        young: Young's modulus of the soft part; the motion depends only on ν and E over the drag [Pa].
        count: steps a frame.
    """
    nodes, tetrahedra = box(BLOCK, FINE_CELLS)
    solid = make_solid(nodes, tetrahedra)
    moduli = young * np.where(stiff(nodes[tetrahedra].mean(axis=1)), STIFF, 1.0)
    material = Material("stable_neo_hookean", moduli, 0.45)
    gripped = _held(nodes, True)
    held = np.broadcast_to((gripped | (nodes[:, 0] < 1e-9))[:, None], nodes.shape).copy()
    axes = tuple(np.linspace(0, side, cells + 1) for side, cells in zip(BLOCK, FINE_CELLS, strict=True))
    volumes = np.bincount(tetrahedra.ravel(), np.repeat(solid.volumes / 4, 4), len(nodes))
    # Drag of a volume [Pa frames/m²]: 1 a particle, 7.5 mm apart, where springs of 1 along the edges and across the
    # sides of cubes make a modulus of about 1.5 over that distance.
    drag = diags_array(np.repeat(young / (1.5 * 0.0075**2) * count * volumes, 3)).tocsr()
    now, near, before, states = np.zeros_like(nodes), None, np.zeros(3), []
    for after in path:
        for step in range(1, count + 1):
            goal = np.where(gripped[:, None], before + step / count * (after - before), 0.0)
            energy = Energy(solid, material, (drag @ now.ravel()).reshape(-1, 3), drag)
            now, _, near = settle(energy, now, goal, held, near=near, tolerance=1e-8)
        before = after
        states.append(_interpolated(axes, now.reshape(*(len(axis) for axis in axes), 3)))
    return states


def _shares(body: Body, visible: np.ndarray, points: np.ndarray) -> csr_array:
    """Points of the flat upper side at rest as shares of the particles of the triangle that holds each, [P, N]."""
    faces = body.faces[np.isin(body.faces, visible).all(axis=1)]
    best, values = holding(body.rest[faces][..., :2], points[:, :2], len(faces))
    starts = 3 * np.arange(len(points) + 1)
    return csr_array((values.ravel(), faces[best].ravel(), starts), shape=(len(points), body.count))


def _spread_out(points: np.ndarray) -> np.ndarray:
    """Keypoints [15] among followed ones [T + 1, P, 3]: of the half that moves most, each far from those before."""
    moved = np.linalg.norm(points - points[0], axis=2).max(axis=0)
    pool = np.argsort(moved)[len(moved) // 2 :]
    return pool[farthest(points[0, pool], len(pool) - 1, KEYPOINTS)]


SEQUENCES = {
    # Away from the pins and up; the half next to the pins is stiff.
    "thin-shell-1": Sequence(
        False,
        60,
        lambda s: np.column_stack((0.025 * s, 0 * s, 0.03 * np.sin(np.pi / 2 * s))),
        lambda rest: rest[:, 0] < SIDE / 2,
    ),
    # To one side, to the other and back, lifted on the way; a spot is stiff.
    "thin-shell-2": Sequence(
        False,
        100,
        lambda s: np.sin(np.pi * np.outer(s, (1, 2, 1))) * (0.02, 0.03, 0.025),
        lambda rest: np.linalg.norm(rest[:, :2] - (0.07, 0.05), axis=1) < 0.04,
    ),
    # A block's free end up, and a little back.
    "volume-1": Sequence(True, 60, lambda s: np.outer(s, (-0.004, 0, 0.025)), lambda rest: rest[:, 1] > BLOCK[1] / 2),
    # A block's free end aside and up.
    "volume-2": Sequence(
        True,
        60,
        lambda s: np.column_stack((0.006 * s, 0.015 * np.sin(np.pi * s), 0.02 * np.sin(np.pi * s / 2))),
        lambda rest: rest[:, 1] < BLOCK[1] / 2,
    ),
}
"""Pulls of the paper by name."""
