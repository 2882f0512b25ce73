"""True motion of tissue that a tool holds and moves, or only passes over.

A sheet under tension on a foundation, m ü + k_d u̇ + K u = 0 away from the grip: the model of `physics.sheet` with its
inertia and damping, on a grid twice as fine, beyond the picture's edges, by another integrator (BDF2 with short steps).
It is the same everywhere in the picture's plane, whatever the tissue's depth.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.sparse.linalg import splu
from scipy.special import k0e, k1e

from data.synthetic.scene import Scene, SceneError, require_room
from data.synthetic.settings import SceneSettings
from data.synthetic.truth import Motion

SUBSTEPS = 8
"""Of the integrator, a frame."""
BEYOND = 32
"""How far the tissue is integrated beyond the picture [grid px]; behind that it goes on as `edge_anchor` has it."""
HELD = 2.5
"""Radius of the tissue between the jaws, around the contact vertex [grid px]."""
RISE = (0.6, 0.95)
"""Share of the time in contact in which the tool reaches its farthest."""
BEND = 0.2
"""How far its way bends aside at most, as a share of its length."""
INSIDE = 12.0
"""The tip stays so far inside the picture [grid px]."""
UNIFORM_DAMPING = 2.0
"""ζ of the motion in which all tissue moves alike: over-damped."""
ASIDE, SOFT = (-4.0, 10.0), 2.0
"""How far the line between two regions passes from the grip, and half the width of the step [grid px]."""
BREATH, SHEAR = (2.0, 4.0), 0.6
"""Period of breathing [s]; how much more or less one edge of the picture moves than its middle."""
PASSES = (15.0, 45.0)
"""From where a tool comes that has not touched yet [grid px]."""


@dataclass(frozen=True)
class GrippedMotion(Motion):
    """What truly happened in a clip whose tool holds tissue from its first frame in contact to the clip's end."""

    course: np.ndarray
    """The tip from where the contact vertex is, in the picture, shape [F, 2] [grid px]; 0 in contact."""
    anchor: float
    """Foundation of a node over the stiffness of a spring, nodes a grid px apart and joined along both diagonals."""
    damping: float
    """k_d/k_s of such nodes [s]."""
    log_stiffness: np.ndarray
    """Of the springs at every grid pixel, relative to the mean over the picture, shape [h, w]."""
    reaction: np.ndarray
    """What holds the gripped tissue over k_s, across the line of sight at the contact's depth, shape [F, 2] [scene
    units]."""


def draw_grip(scene: Scene, generator: np.random.Generator) -> GrippedMotion:
    """Draw tissue and the tool's way, and integrate.

    Raises:
        SceneError: the tool has no room for a way as long as is wanted, or the clip is too long.
    """
    settings = scene.settings
    onset = round(generator.uniform(*settings.onset_fraction) * settings.frames)
    spread = math.exp(generator.uniform(*np.log(settings.spread)))
    relaxation = math.exp(generator.uniform(*np.log(settings.relaxation)))
    way, course = draw_way(scene, generator), draw_course(onset, settings, generator)
    # Neighbours on both diagonals: every node has springs worth three in the picture's plane.
    anchor = 3 / spread**2
    log_stiffness = _draw_regions(scene, generator)
    inner = (slice(BEYOND, -BEYOND), slice(BEYOND, -BEYOND))
    times = np.arange(settings.frames) / settings.fps
    require_room(2 * settings.frames * math.prod(scene.mesh.grid_shape))
    moved, reaction = np.zeros((settings.frames, *scene.mesh.grid_shape, 2)), np.zeros((settings.frames, 2))
    if onset < settings.frames - 1:
        steps = SUBSTEPS * (settings.frames - 1 - onset)
        path = way(np.arange(1, steps + 1) / steps)
        moved[onset:], reaction[onset:] = _integrate(scene, log_stiffness, anchor, relaxation, path)
    moved += _draw_breathing(scene, times, generator)
    field = _in_space(scene, moved)
    return GrippedMotion(
        onset_frame=onset,
        release_frame=settings.frames,
        times=times,
        contact=field[:, scene.vertex].astype(np.float64),
        moving=np.arange(len(scene.mesh.vertices)),
        field=field,
        course=course,
        anchor=anchor,
        damping=anchor * relaxation,
        log_stiffness=log_stiffness[inner],
        reaction=reaction * scene.spacing,
    )


def draw_way(scene: Scene, generator: np.random.Generator) -> Callable[[np.ndarray], np.ndarray]:
    """Where the tool has moved tissue at shares of its time in contact, a function of [S] that gives [S, 2] [grid px].

    From rest, across the line of sight, slowly at both ends.

    Raises:
        SceneError: it would leave the picture.
    """
    settings = scene.settings
    size = np.array([settings.grid_width, settings.grid_height])
    row, column = scene.mesh.pixels[scene.vertex]
    for _ in range(100):
        length = generator.uniform(*settings.peak_displacement) / scene.spacing
        angle = generator.uniform(0, 2 * np.pi)
        far = length * np.array([math.cos(angle), math.sin(angle)])
        end = np.array([column, row]) + far
        if (end > INSIDE).all() and (end < size - INSIDE).all():
            break
    else:
        raise SceneError(
            f"scene.peak_displacement {settings.peak_displacement} moves the tip out of the picture; choose smaller."
        )
    aside = generator.uniform(-BEND, BEND) * np.array([-far[1], far[0]])
    rise = generator.uniform(*RISE)

    def way(shares: np.ndarray) -> np.ndarray:
        share = np.clip(shares / rise, 0, 1)
        gone = (share**3 * (10 - 15 * share + 6 * share**2))[:, None]
        return gone * far + 4 * gone * (1 - gone) * aside

    return way


def draw_course(onset: int, settings: SceneSettings, generator: np.random.Generator) -> np.ndarray:
    """The tip's way before it touches, shape [F, 2] [grid px]: it comes in an arc, or passes if it never touches."""
    angle, bend = generator.uniform(0, 2 * np.pi), generator.uniform(-0.5, 0.5)
    far = generator.uniform(*PASSES) * np.array([math.cos(angle), math.sin(angle)])
    left = np.clip((onset - np.arange(settings.frames)) / max(onset, 1), 0, 1)[:, None]
    left = 2 * left - 1 if onset >= settings.frames else left * left * (3 - 2 * left)
    return left * far + bend * (left - left * np.abs(left)) * np.array([-far[1], far[0]])


def _draw_regions(scene: Scene, generator: np.random.Generator) -> np.ndarray:
    """Log stiffness over the tissue, the picture's mean 0: a smooth step across a line that passes by the grip."""
    row, column = scene.mesh.pixels[scene.vertex]
    rows, columns = (side + 2 * BEYOND for side in scene.mesh.grid_shape)
    angle, aside = generator.uniform(0, 2 * np.pi), generator.uniform(*ASIDE)
    down, right = np.mgrid[:rows, :columns] - BEYOND - np.array([row, column])[:, None, None]
    across = right * math.cos(angle) + down * math.sin(angle) - aside
    log = math.log(scene.settings.regions) / 2 * np.tanh(across / SOFT)
    return log - log[BEYOND:-BEYOND, BEYOND:-BEYOND].mean()


def _draw_breathing(scene: Scene, times: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Affine motion of the background since the first frame, shape [F, h, w, 2] [grid px]."""
    height, width = scene.mesh.grid_shape
    size, period = generator.uniform(*scene.settings.breathing), generator.uniform(*BREATH)
    phase, angle = generator.uniform(0, 2 * np.pi, 2)
    swing = np.sin(2 * np.pi * times / period + phase) - math.sin(phase)
    places = np.moveaxis(np.mgrid[:height, :width], 0, -1) / width - 0.5
    shape = np.array([math.cos(angle), math.sin(angle)]) + places @ generator.uniform(-SHEAR, SHEAR, (2, 2))
    return size / 2 * swing[:, None, None, None] * shape


def _integrate(
    scene: Scene, log_stiffness: np.ndarray, anchor: float, relaxation: float, way: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The sheet from rest while its grip goes along a way.

    Args:
        log_stiffness: of the tissue, also beyond the picture, shape [h + 2 BEYOND, w + 2 BEYOND].
        anchor: foundation over a spring's mean stiffness.
        relaxation: damping over foundation [s].
        way: displacement of the grip after each step, shape [S, 2] [grid px].

    Returns:
        Displacement of the picture's nodes at the frames' times, shape [S / SUBSTEPS + 1, h, w, 2], and what holds the
        grip, shape [S / SUBSTEPS + 1, 2] [unit of a spring's stiffness × grid px].
    """
    rows, columns = (side + 2 * BEYOND for side in scene.mesh.grid_shape)
    mass, damping = anchor * (relaxation / (2 * UNIFORM_DAMPING)) ** 2, anchor * relaxation
    step = 1 / (scene.settings.fps * SUBSTEPS)
    grip = scene.mesh.pixels[scene.vertex] + BEYOND
    matrix = lattice_matrix(log_stiffness, anchor + edge_anchor(log_stiffness, anchor, grip))
    shift = mass * 9 / (4 * step**2) + damping * 3 / (2 * step)
    row, column = np.mgrid[:rows, :columns] - BEYOND
    apart = np.hypot(row - scene.mesh.pixels[scene.vertex, 0], column - scene.mesh.pixels[scene.vertex, 1])
    held = (apart <= HELD).ravel()
    advanced = matrix + shift * diags_array(np.ones(rows * columns))
    free = advanced[~held]
    # Symmetric and positive: no pivoting.
    factors = splu(
        free[:, ~held].tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    ties = free[:, held].sum(axis=1)[:, None]
    place, before, speed, speed_before = (np.zeros((rows * columns, 2)) for _ in range(4))
    seen, reaction = [np.zeros((*scene.mesh.grid_shape, 2))], [np.zeros(2)]
    inner = (slice(BEYOND, rows - BEYOND), slice(BEYOND, columns - BEYOND))
    for index, target in enumerate(way, start=1):
        carried = (4 * place - before) / (2 * step)
        pushed = (mass * (3 / (2 * step)) + damping) * carried + mass * (4 * speed - speed_before) / (2 * step)
        moved = np.empty_like(place)
        moved[held] = target
        moved[~held] = factors.solve(pushed[~held] - ties * target)
        new_speed = 3 / (2 * step) * moved - carried
        force = (advanced[held] @ moved - pushed[held]).sum(axis=0)
        place, before, speed, speed_before = moved, place, new_speed, speed
        if index % SUBSTEPS == 0:
            seen.append(moved.reshape(rows, columns, 2)[inner])
            reaction.append(force)
    return np.array(seen), np.array(reaction)


def edge_anchor(log_stiffness: np.ndarray, anchor: float, grip: np.ndarray) -> np.ndarray:
    """What tissue that goes on beyond an edge adds to the anchor of the edge's nodes, shape [rows, columns].

    Around a grip motion at rest dies away as K₀(r/L), L² = 3 · stiffness/anchor, so that across the edge it falls by
    K₁/K₀ · cos(angle)/L a node, which three springs carry. A free edge would reflect what reaches it.

    Args:
        log_stiffness: at the nodes, shape [rows, columns].
        anchor: of every node.
        grip: row and column of the node that is gripped, shape [2].
    """
    reach = np.sqrt(3 * np.exp(log_stiffness) / anchor)
    apart = np.moveaxis(np.indices(log_stiffness.shape), 0, -1) - grip
    distance = np.maximum(np.linalg.norm(apart, axis=-1), 1.0)
    # Scaled by e^(r/L), both alike, so that neither is too small to divide.
    falls = k1e(distance / reach) / k0e(distance / reach) / reach
    added = np.zeros(log_stiffness.shape)
    for axis in (0, 1):
        sides, across = (
            np.moveaxis(values, axis, 0) for values in (added, np.abs(apart[..., axis]) / distance * falls)
        )
        sides[[0, -1]] += across[[0, -1]]
    return 3 * np.exp(log_stiffness) * added


def lattice_matrix(log_stiffness: np.ndarray, anchor: float | np.ndarray) -> csr_array:
    """K of a grid of nodes with springs along both axes and both diagonals, shape [N, N].

    Args:
        log_stiffness: at the nodes, shape [rows, columns]; a spring has the geometric mean of its ends'.
        anchor: of every node, or of each, shape [rows, columns].
    """
    number = np.arange(log_stiffness.size).reshape(log_stiffness.shape)
    neighbours = (
        (number[:-1], number[1:]),
        (number[:, :-1], number[:, 1:]),
        (number[:-1, :-1], number[1:, 1:]),
        (number[1:, :-1], number[:-1, 1:]),
    )
    one, two = (np.concatenate([pair[end].ravel() for pair in neighbours]) for end in (0, 1))
    places = np.r_[one, two], np.r_[two, one]
    log = log_stiffness.ravel()
    stiffness = np.exp((log[one] + log[two]) / 2)
    ties = coo_array((np.tile(stiffness, 2), places), (log.size,) * 2).tocsr()
    return csr_array(diags_array(ties.sum(axis=1) + np.ravel(anchor)) - ties)


def _in_space(scene: Scene, moved: np.ndarray) -> np.ndarray:
    """Displacement of the mesh's vertices in space, shape [F, N, 3], float32, of one in the picture [F, h, w, 2]."""
    row, column = scene.mesh.pixels.T
    depth = scene.mesh.vertices[:, 2:].astype(np.float64)
    across = moved[:, row, column] / [scene.grid_camera.fx, scene.grid_camera.fy] * depth
    return np.concatenate([across, np.zeros_like(across[..., :1])], axis=-1).astype(np.float32)
