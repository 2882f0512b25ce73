"""Contacts without pictures: motions of the true scenes' meshes, as many as a network's first training needs.

Geometry, tissue and timing are drawn as for the synthetic clips (`data.synthetic`), but the motion is the simulator's
own and nothing is rendered, which is some hundred times faster. What a training reads of them is the observed motion; θ
is kept for evaluation alone.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from data.contact.interaction import Interaction
from data.synthetic.scene import Scene, crop_mesh, draw_scene
from data.synthetic.settings import SceneSettings
from data.synthetic.truth import draw_theta
from physics.load import Press, held
from physics.mechanics import Mechanics
from physics.mesh import Mesh
from physics.msd.simulation import simulate
from physics.observation import Observation

REACH = 40
"""Half side of the part of the mesh that is kept [grid pixels]: no wave returns from farther away within a second."""
FINE = Mechanics(time_step=0.0025, steps=400, scheme="dkd", window_error=1e-5)
"""The simulator that makes the motions."""
ATTEMPTS = 60


@dataclass(frozen=True)
class SimulatedContact:
    """A contact, its motion without noise, and the truth that no training reads."""

    interaction: Interaction
    """Motion at the frames' times; its noise is 0 and must be added."""
    theta: np.ndarray
    """[k_s, k_d, F], shape [3]."""


def draw_contacts(settings: SceneSettings, seed: int, count: int, time_step: float) -> list[SimulatedContact]:
    """Contacts of one scene, each with its own tissue and timing; fewer where too many draws move too much or little.

    Args:
        settings: what is drawn.
        seed: of this scene.
        count: contacts.
        time_step: of the loads' steps [s].
    """
    scene = draw_scene(settings, np.random.default_rng([seed, 0]))
    generator = np.random.default_rng([seed, 1])
    mesh, kept, _ = crop_mesh(scene.mesh, scene.vertex, REACH)
    vertex = int(np.searchsorted(kept, scene.vertex))
    draws = (_draw_contact(scene, mesh, vertex, generator, time_step) for _ in range(ATTEMPTS * count))
    return list(itertools.islice(filter(None, draws), count))


def _draw_contact(
    scene: Scene, mesh: Mesh, vertex: int, generator: np.random.Generator, time_step: float
) -> SimulatedContact | None:
    settings = scene.settings
    theta = draw_theta(settings, generator)
    load_frames = max(1, round(generator.uniform(*settings.press_seconds) * settings.fps))
    seconds = load_frames / settings.fps
    fine = round(seconds / FINE.time_step)
    low, high = settings.peak_displacement
    pressed = simulate(theta, mesh, Press.at(vertex, scene.direction, np.ones(fine)), FINE)
    if not low <= np.linalg.norm(pressed, axis=1).max() <= high:
        return None
    path = simulate(theta, mesh, Press.at(vertex, scene.direction, held(fine, FINE.steps)), FINE)
    times = np.arange(1, round(settings.fps) + 1) / settings.fps
    press = Press.at(vertex, scene.direction.astype(np.float32), held(round(seconds / time_step), round(1 / time_step)))
    moved = Observation.of_point(vertex, times, path[np.rint(times / FINE.time_step).astype(np.int64) - 1], 0.0)
    return SimulatedContact(Interaction(mesh, press, moved, time_step), theta)
