"""True motion of tissue that a tool holds and moves, or only passes over.

The model is a sheet under tension on a foundation, m ü + k_d u̇ + K u = 0 away from the grip: that of `physics.sheet`
with inertia and damping. The integrator is BDF2 with short steps, on a grid twice as fine that continues outside the
picture. The sheet lies in the picture's plane and is the same everywhere at any depth of the tissue.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, diags_array
from scipy.special import k0e, k1e

from palpate.data.synthetic.scene import Scene, draw_way, require_room
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.truth import TrueMotion
from palpate.physics.fem.linear_system import factorised
from palpate.physics.mesh import grid_springs, laplacian

SUBSTEPS = 8
"""Time steps of the integrator a frame."""
MARGIN_PX = 32
"""Width of the tissue that is integrated outside the picture [grid px]; `edge_anchor` stands for farther tissue."""
GRIP_RADIUS = 2.5
"""Radius of the tissue between the jaws, around the contact vertex [grid px]."""


@dataclass(frozen=True, kw_only=True)
class GrippedMotion(TrueMotion):
    """True motion of a sheet that a tool holds from its first frame in contact to the clip's end."""

    course: np.ndarray
    """Offset of an island's tool from the contact vertex in the picture, shape [F, 2] [grid px]; 0 in contact."""
    anchor: float
    """Foundation of a node over the stiffness of a spring, nodes a grid px apart and joined along both diagonals."""
    damping: float
    """k_d/k_s of such nodes [s]."""
    log_stiffness: np.ndarray
    """Log stiffness of the springs at every grid pixel, less its mean over the picture, shape [h, w]."""
    reaction: np.ndarray
    """Force that holds the gripped tissue, divided by k_s, across the line of sight at the contact's depth, shape
    [F, 2] [scene units]."""


def draw_grip(scene: Scene, generator: np.random.Generator) -> GrippedMotion:
    """Draw tissue and the tool's path, and integrate.

    Raises:
        SceneError: the tool has no room for a path as long as the settings want, or the clip is too long.
    """
    settings = scene.settings
    onset = round(generator.uniform(*settings.onset_fraction) * settings.frames)
    if settings.action in ("hover", "pass"):
        onset = settings.frames
    spread = math.exp(generator.uniform(*np.log(settings.spread)))
    relaxation = math.exp(generator.uniform(*np.log(settings.relaxation)))
    path, course = draw_tip_path(scene, generator), draw_course(onset, settings, generator)
    # Neighbours on both diagonals: every node has springs worth three in the picture's plane.
    anchor = 3 / spread**2
    log_stiffness = _draw_regions(scene, generator)
    inner = (slice(MARGIN_PX, -MARGIN_PX), slice(MARGIN_PX, -MARGIN_PX))
    times = np.arange(settings.frames) / settings.fps
    require_room(2 * settings.frames * math.prod(scene.mesh.grid_shape))
    moved, reaction = np.zeros((settings.frames, *scene.mesh.grid_shape, 2)), np.zeros((settings.frames, 2))
    if onset < settings.frames - 1:
        steps = SUBSTEPS * (settings.frames - 1 - onset)
        targets = path(np.arange(1, steps + 1) / steps)
        moved[onset:], reaction[onset:] = _integrate(scene, log_stiffness, anchor, relaxation, targets)
    field = _in_space(scene, moved)
    return GrippedMotion(
        onset_frame=onset,
        release_frame=settings.frames,
        times=times,
        contact=field[:, scene.vertex].astype(np.float64),
        moving=np.arange(len(scene.mesh.vertices)),
        field=field,
        course=course,
        touched=np.full(settings.frames, scene.vertex),
        anchor=anchor,
        damping=anchor * relaxation,
        log_stiffness=log_stiffness[inner],
        reaction=reaction * scene.spacing,
    )


def draw_tip_path(scene: Scene, generator: np.random.Generator) -> Callable[[np.ndarray], np.ndarray]:
    """Displacement of the gripped tissue, a function of shares [S] of the time in contact, giving [S, 2] [grid px].

    The path starts at rest, lies across the line of sight, and is slow at both ends.

    Raises:
        SceneError: the path would leave the picture.
    """
    far = draw_way(scene, "peak_displacement", scene.spacing, generator)
    sideways = generator.uniform(-0.2, 0.2) * np.array([-far[1], far[0]])
    rise = generator.uniform(0.6, 0.95)  # share of the time in contact after which the tool is farthest from its start

    def path(shares: np.ndarray) -> np.ndarray:
        share = np.clip(shares / rise, 0, 1)
        progress = (share**3 * (10 - 15 * share + 6 * share**2))[:, None]
        return progress * far + 4 * progress * (1 - progress) * sideways

    return path


def draw_course(onset: int, settings: SceneSettings, generator: np.random.Generator) -> np.ndarray:
    """Offset of the tip from the contact before it touches, shape [F, 2] [grid px].

    The tip comes in an arc, or passes over the contact if it never touches.
    """
    angle, bend = generator.uniform(0, 2 * np.pi), generator.uniform(-0.5, 0.5)
    far = generator.uniform(15.0, 45.0) * np.array([math.cos(angle), math.sin(angle)])  # where the approach begins
    left = np.clip((onset - np.arange(settings.frames)) / max(onset, 1), 0, 1)[:, None]
    left = 2 * left - 1 if onset >= settings.frames else left * left * (3 - 2 * left)
    return left * far + bend * (left - left * np.abs(left)) * np.array([-far[1], far[0]])


def _draw_regions(scene: Scene, generator: np.random.Generator) -> np.ndarray:
    """Log stiffness over the tissue, the picture's mean 0: a smooth step across a line near the grip."""
    row, column = scene.mesh.pixels[scene.vertex]
    rows, columns = (side + 2 * MARGIN_PX for side in scene.mesh.grid_shape)
    angle, offset = generator.uniform(0, 2 * np.pi), generator.uniform(-4.0, 10.0)
    down, right = np.mgrid[:rows, :columns] - MARGIN_PX - np.array([row, column])[:, None, None]
    across = right * math.cos(angle) + down * math.sin(angle) - offset
    log = math.log(scene.settings.regions) / 2 * np.tanh(across / 2.0)
    return log - log[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX].mean()


def _integrate(
    scene: Scene, log_stiffness: np.ndarray, anchor: float, relaxation: float, path: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Motion of the sheet from rest while its grip follows a path.

    Args:
        log_stiffness: log stiffness of the tissue, also outside the picture, shape [h + 2 MARGIN_PX, w + 2 MARGIN_PX].
        anchor: foundation over a spring's mean stiffness.
        relaxation: damping over foundation [s].
        path: displacement of the grip after each step, shape [S, 2] [grid px].

    Returns:
        Displacement of the picture's nodes at the T = S / SUBSTEPS + 1 frames' times, shape [T, h, w, 2], and the force
        that holds the grip, shape [T, 2] [unit of a spring's stiffness × grid px].
    """
    rows, columns = (side + 2 * MARGIN_PX for side in scene.mesh.grid_shape)
    # The motion in which all tissue has the same displacement is over-damped, ζ = 2.
    mass, damping = anchor * (relaxation / (2 * 2.0)) ** 2, anchor * relaxation
    step = 1 / (scene.settings.fps * SUBSTEPS)
    grip = scene.mesh.pixels[scene.vertex] + MARGIN_PX
    matrix = lattice_matrix(log_stiffness, anchor + edge_anchor(log_stiffness, anchor, grip))
    shift = mass * 9 / (4 * step**2) + damping * 3 / (2 * step)
    row, column = np.mgrid[:rows, :columns] - MARGIN_PX
    apart = np.hypot(row - scene.mesh.pixels[scene.vertex, 0], column - scene.mesh.pixels[scene.vertex, 1])
    held = (apart <= GRIP_RADIUS).ravel()
    advanced = matrix + shift * diags_array(np.ones(rows * columns))
    free = advanced[~held]
    factors = factorised(free[:, ~held].tocsc())
    ties = free[:, held].sum(axis=1)[:, None]
    place, before, speed, speed_before = (np.zeros((rows * columns, 2)) for _ in range(4))
    displacement, reaction = [np.zeros((*scene.mesh.grid_shape, 2))], [np.zeros(2)]
    inner = (slice(MARGIN_PX, rows - MARGIN_PX), slice(MARGIN_PX, columns - MARGIN_PX))
    for index, target in enumerate(path, start=1):
        carried = (4 * place - before) / (2 * step)
        pushed = (mass * (3 / (2 * step)) + damping) * carried + mass * (4 * speed - speed_before) / (2 * step)
        moved = np.empty_like(place)
        moved[held] = target
        moved[~held] = factors.solve(pushed[~held] - ties * target)
        new_speed = 3 / (2 * step) * moved - carried
        force = (advanced[held] @ moved - pushed[held]).sum(axis=0)
        place, before, speed, speed_before = moved, place, new_speed, speed
        if index % SUBSTEPS == 0:
            displacement.append(moved.reshape(rows, columns, 2)[inner])
            reaction.append(force)
    return np.array(displacement), np.array(reaction)


def edge_anchor(log_stiffness: np.ndarray, anchor: float, grip: np.ndarray) -> np.ndarray:
    """Anchor that stands for the tissue outside an edge, at the edge's nodes, shape [rows, columns]; 0 elsewhere.

    Around a grip, displacement at rest dies away as K₀(r/L), L² = 3 · stiffness/anchor. Across the edge it falls by
    K₁/K₀ · cos(angle)/L a node, which three springs carry. A free edge would reflect what reaches it.

    Args:
        log_stiffness: log stiffness at the nodes, shape [rows, columns].
        anchor: foundation of every node.
        grip: row and column of the node that is gripped, shape [2].
    """
    reach = np.sqrt(3 * np.exp(log_stiffness) / anchor)
    apart = np.moveaxis(np.indices(log_stiffness.shape), 0, -1) - grip
    distance = np.maximum(np.linalg.norm(apart, axis=-1), 1.0)
    # Both are scaled by e^(r/L), so that neither is too small to divide.
    falls = k1e(distance / reach) / k0e(distance / reach) / reach
    added = np.zeros(log_stiffness.shape)
    for axis in (0, 1):
        leaving = np.abs(apart[..., axis]) / distance * falls
        sides, across = (np.moveaxis(values, axis, 0) for values in (added, leaving))
        sides[[0, -1]] += across[[0, -1]]
    return 3 * np.exp(log_stiffness) * added


def lattice_matrix(log_stiffness: np.ndarray, anchor: float | np.ndarray) -> csr_array:
    """K of a grid of nodes with springs along both axes and both diagonals, shape [N, N].

    Args:
        log_stiffness: log stiffness at the nodes, shape [rows, columns]; a spring has the geometric mean of its ends'.
        anchor: foundation, one number for all nodes or shape [rows, columns].
    """
    shape = log_stiffness.shape
    springs = np.concatenate([grid_springs(shape, *step) for step in ((1, 0), (0, 1), (1, 1), (1, -1))])
    stiffness = np.exp(log_stiffness.ravel()[springs].mean(axis=1))
    return laplacian(springs, stiffness, np.broadcast_to(anchor, shape).ravel())


def _in_space(scene: Scene, moved: np.ndarray) -> np.ndarray:
    """Displacement of the mesh's vertices in space, shape [F, N, 3], float32, from that in the picture [F, h, w, 2]."""
    row, column = scene.mesh.pixels.T
    depth = scene.mesh.vertices[:, 2:].astype(np.float64)
    across = moved[:, row, column] / [scene.grid_camera.fx, scene.grid_camera.fy] * depth
    return np.concatenate([across, np.zeros_like(across[..., :1])], axis=-1).astype(np.float32)
