"""Contacts without pictures: motions of the true scenes' meshes, as many as a network's first training needs.

Geometry, tissue and timing are drawn as for the synthetic clips (`data.synthetic`). The motion is the simulator's own
and nothing is rendered, which is some hundred times faster. Training reads the observed motion; θ is for evaluation.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from scipy.interpolate import CubicSpline

from palpate.data.contact.interaction import Interaction
from palpate.data.synthetic.scene import Scene, crop_mesh, draw_scene
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.tool import TIP_START, jaw_width
from palpate.data.synthetic.truth import draw_theta
from palpate.physics.depth import REACH as SEQUENCE_REACH
from palpate.physics.depth import DepthSequence, SequenceNoise
from palpate.physics.load import Press, held
from palpate.physics.mechanics import Mechanics
from palpate.physics.mesh import Mesh
from palpate.physics.msd.simulation import simulate
from palpate.physics.observation import Observation
from palpate.physics.patches import Patches

CROP_RADIUS = 40
"""Half side of the part of the mesh that is kept [grid px]: no wave returns from farther away within a second."""
FINE_MECHANICS = Mechanics(time_step=0.0025, steps=400, scheme="dkd", window_error=1e-5)
"""The simulator that makes the motions."""


@dataclass(frozen=True)
class SimulatedContact:
    """A contact, its motion without noise, and the truth that no training reads."""

    interaction: Interaction
    """Motion at the frames' times, and the depth-change sequence where one was asked for; both are without noise, which
    must be added."""
    theta: np.ndarray
    """[k_s, k_d, F], shape [3]."""


def draw_contacts(
    settings: SceneSettings, seed: int, count: int, time_step: float, within: float = 0.0, sequence: bool = False
) -> list[SimulatedContact]:
    """Contacts of one scene, each with its own tissue and timing; fewer where too many draws move too much or little.

    Args:
        settings: ranges from which scene, tissue and timing are drawn.
        seed: seed of this scene.
        count: number of contacts.
        time_step: duration of a step of the loads [s].
        within: largest difference between the true and the stamped time of a press's begin, and of its end [s].
        sequence: True = with the dents' depth-change sequences, in pictures of the grid's size or of
            CholecSeg8k's, drawn for each contact.
    """
    scene = draw_scene(settings, np.random.default_rng([seed, 0]))
    generator = np.random.default_rng([seed, 1])
    mesh, kept, _ = crop_mesh(scene.mesh, scene.vertex, CROP_RADIUS)
    vertex = int(np.searchsorted(kept, scene.vertex))
    grid = settings.grid_width, settings.grid_height
    patches = [Patches(mesh, vertex, size) for size in (grid, (854, 480))] if sequence else []
    place = scene, mesh, vertex, patches
    draws = (_draw_press(*place, time_step, within, generator) for _ in range(60 * count))
    return list(itertools.islice(filter(None, draws), count))


def _draw_press(
    scene: Scene, mesh: Mesh, vertex: int, patches: list[Patches], time_step: float, within: float, generator: Generator
) -> SimulatedContact | None:
    """One contact, or None where it moves too much or too little; arguments as in `draw_contacts`.

    Args:
        mesh, vertex: the part of the scene's mesh that is simulated, and its contact vertex.
        patches: views of which one is drawn for the depth-change sequence; empty = none is made.
    """
    settings, direction = scene.settings, scene.direction
    theta = draw_theta(settings, generator)
    stamped = max(1, round(generator.uniform(*settings.press_seconds) * settings.fps)) / settings.fps
    delay, release = generator.uniform(-within, within, 2) if within else (0.0, 0.0)
    loaded = max(stamped + release - delay, 0.02) / FINE_MECHANICS.time_step
    low, high = settings.peak_displacement
    whole = Press.at(vertex, direction, np.ones(round(loaded) or 1))
    pressed = simulate(theta, mesh, whole, FINE_MECHANICS)
    if not low <= np.linalg.norm(pressed, axis=1).max() <= high:
        return None
    view = patches[int(generator.integers(len(patches)))] if patches else None
    watch = np.array([vertex]) if view is None else np.append(vertex, view.vertices)
    steps = FINE_MECHANICS.steps + math.ceil(within / FINE_MECHANICS.time_step)
    press = Press.at(vertex, direction, held(loaded, steps))
    path = simulate(theta, mesh, press, FINE_MECHANICS, watch=watch)
    times = np.arange(1, round(settings.fps) + 1) / settings.fps
    if within:
        after = FINE_MECHANICS.time_step * np.arange(steps + 1)
        curve = CubicSpline(after, np.concatenate([np.zeros_like(path[:1]), path]))
        moved = curve(np.maximum(times - delay, 0))
    else:
        moved = path[np.rint(times / FINE_MECHANICS.time_step).astype(np.int64) - 1]
    stamps = held(round(stamped / time_step), round(1 / time_step))
    load = Press.at(vertex, direction.astype(np.float32), stamps)
    observed = Observation.of_point(vertex, times, moved[:, 0], 0.0)
    sequence = None if view is None else _sequence(view, moved[:, 1:], times, stamped, generator)
    return SimulatedContact(Interaction(mesh, load, {"point": observed}, time_step).having(depth=sequence), theta)


def _sequence(
    view: Patches, moved: np.ndarray, times: np.ndarray, stamped: float, generator: Generator
) -> DepthSequence:
    """The depth-change sequence of displacements [N, V, 3], the tool hiding some pixels until a time [s]."""
    side = 2 * SEQUENCE_REACH + 1
    change = view.shown(view.sunk(moved), view.covering(moved)).reshape(len(times), side, side)
    change[np.ix_(times < stamped - 1e-9, *[np.ones(side, bool)] * 2)] += hidden_by_tool(generator)
    return DepthSequence(times, change.astype(np.float32), SequenceNoise(0.0, 0.0), view.size)


def hidden_by_tool(generator: Generator) -> np.ndarray:
    """NaN where a tool that touches the middle from a random side hides a sequence's pixels, else 0, shape [S, S]."""
    angle = generator.uniform(0, 2 * math.pi)
    rows, columns = np.mgrid[-SEQUENCE_REACH : SEQUENCE_REACH + 1, -SEQUENCE_REACH : SEQUENCE_REACH + 1]
    along = columns * math.cos(angle) + rows * math.sin(angle)
    across = rows * math.cos(angle) - columns * math.sin(angle)
    return np.where((along >= TIP_START) & (np.abs(across) <= jaw_width(along)), np.nan, 0.0)
