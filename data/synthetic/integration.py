"""Integration of a press on the part of the sheet that it moves: DOP853, in double precision (see `truth`)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.sparse import csr_array

from palpate.data.synthetic.scene import Scene, SceneError, crop_mesh, require_room
from palpate.data.synthetic.settings import SceneSettings
from palpate.physics.load import Press, PressShape
from palpate.physics.mesh import Mesh, incidence

RELATIVE_TOLERANCE, ABSOLUTE_TOLERANCE = 1e-6, 1e-9
"""Tolerances of the integrator's local error, for positions within about 1e-6 scene units."""
STILL = np.zeros(2)
"""Travel of a press that stays where it is, rows and columns [grid px]."""


@dataclass(frozen=True)
class MeshWindow:
    """The part of the mesh that moves."""

    mesh: Mesh
    """The part itself, without triangles, its cut edge held."""
    vertices: np.ndarray
    """Vertices of the whole mesh, shape [M]."""
    difference: csr_array
    """Spring end minus spring start of vertex values, shape [S, M]."""
    edges: np.ndarray
    """Spring vectors at rest, shape [S, 3]."""
    lengths: np.ndarray
    """Spring rest lengths, shape [S]."""
    stiffness: np.ndarray
    """Stiffness of every spring relative to k_s, shape [S]."""
    held: np.ndarray
    """Vertices that don't move, shape [M], bool."""
    cut: np.ndarray
    """Vertices where the window cuts the mesh, shape [M], bool."""
    contact: int
    """Row of the contact vertex."""
    press: Press
    """The load at its start."""


def force_factor(shape: PressShape, time: np.ndarray, load: float) -> np.ndarray:
    """Force at a time since its start as a share of F, for times within the load, whose end is `load` [s]."""
    risen = np.clip(time / shape.rise, 0.0, 1.0) if shape.rise else np.ones_like(time)
    left = np.clip((load - time) / shape.fall, 0.0, 1.0) if shape.fall else np.ones_like(time)
    return np.minimum(risen, left)


class Pressing(NamedTuple):
    """A press to integrate."""

    theta: np.ndarray
    load: float
    """Time under load [s]."""
    shape: PressShape
    variation: np.ndarray | None
    """Relative stiffness over the grid, shape [h, w]; None = 1 everywhere."""
    travel: np.ndarray = STILL

    def shares(self, window: MeshWindow, time: float) -> tuple[np.ndarray | slice, np.ndarray]:
        """Vertices under load at a time since its start, and the share of the force on each."""
        if not self.travel.any():
            return window.press.vertices, window.press.weights
        apart = window.mesh.pixels - window.mesh.pixels[window.contact] - self.travel * min(time / self.load, 1.0)
        weights = np.exp(-2 * np.square(apart).sum(axis=1) / self.shape.radius**2)
        return slice(None), weights / weights.sum()


def _reach(scene: Scene, theta: np.ndarray, duration: float) -> int:
    """Radius that the motion reaches [grid px]: that of a wave's front, or of diffusion where damping dominates."""
    stiffness, damping, _ = theta
    wave = 1.42 * math.sqrt(stiffness / scene.settings.mass) * duration
    diffusion = 3 * math.sqrt(stiffness / damping * duration)
    return math.ceil(min(wave, diffusion)) + 8


def cut_window(scene: Scene, radius: int, variation: np.ndarray | None, shape: PressShape) -> MeshWindow:
    """Vertices within `radius` grid px of the contact and the springs among them; the cut border is held."""
    mesh, vertices, cut = crop_mesh(scene.mesh, scene.vertex, radius)
    difference = -incidence(mesh.springs, len(vertices)).T.tocsr()
    edges = difference @ mesh.vertices.astype(np.float64)
    relative = np.ones(len(edges))
    if variation is not None:
        relative = variation[tuple(mesh.pixels.T)][mesh.springs].mean(axis=1)
    contact = int(np.searchsorted(vertices, scene.vertex))
    press, held = shape.press(mesh, contact, scene.direction, 1.0, 1.0, 1), mesh.rim.copy()
    held[press.vertices] = False
    lengths = np.linalg.norm(edges, axis=1)
    return MeshWindow(mesh, vertices, difference, edges, lengths, relative, held, cut, contact, press)


def integrate(
    scene: Scene, press: Pressing, coarse: np.ndarray, fine: np.ndarray
) -> tuple[MeshWindow, np.ndarray, np.ndarray]:
    """The window, all its displacements at the coarse times [C, M, 3], and the contact's at the fine times [R, 3].

    Times count from the start of the force, before which the tissue is at rest. The window grows until nothing moves
    where it cuts the mesh.
    """
    radius = _reach(scene, press.theta, max(coarse[-1], fine[-1])) + math.ceil(np.linalg.norm(press.travel))
    largest, times = max(scene.mesh.grid_shape), np.union1d(coarse, fine)
    while True:
        window = cut_window(scene, radius, press.variation, press.shape)
        require_room(len(coarse) * len(window.vertices) * 3)
        states = _solve(scene, window, press, times)
        displaced = states[np.searchsorted(times, coarse)]
        # Displacements of the vertices that a spring joins to the cut.
        joined = abs(window.difference)
        neighbours = (joined.T @ (joined @ window.cut.astype(np.float64))) > 0
        leak = np.abs(displaced[:, neighbours]).max(initial=0)
        if leak <= 1e-6 or radius >= largest:
            return window, displaced, states[np.searchsorted(times, fine), window.contact]
        radius = math.ceil(1.5 * radius)


def _solve(scene: Scene, window: MeshWindow, press: Pressing, times: np.ndarray) -> np.ndarray:
    """Displacements at ascending times, shape [T, M, 3]; press and release apart, since the force may jump between."""
    count, load, end = len(window.vertices), press.load, times[-1]
    state, tolerances = np.zeros(6 * count), {"rtol": RELATIVE_TOLERANCE, "atol": ABSOLUTE_TOLERANCE}
    displaced = np.zeros((len(times), count, 3))
    for start, stop, force in ((0.0, min(load, end), press.theta[2]), (load, end, 0.0)):
        if stop <= start:
            continue
        inside = (times > start) & (times <= stop)
        wanted = np.union1d(times[inside], stop)
        rate = _rate(scene.settings, window, press, force)
        solution = solve_ivp(rate, (start, stop), state, "DOP853", wanted, **tolerances)
        if not solution.success:
            raise SceneError(
                f"The motion at θ = {press.theta} can't be integrated ({solution.message}); narrow the θ box."
            )
        displaced[inside] = solution.y.T.reshape(len(wanted), 2, count, 3)[: inside.sum(), 0]
        state = solution.y[:, -1]
    return displaced


def _rate(settings: SceneSettings, window: MeshWindow, press: Pressing, force: float):
    """Right-hand side of the equations of motion for the state (displacement, velocity), flattened."""
    stiffness, damping, _ = press.theta
    transposed = window.difference.T.tocsr()
    scale = stiffness * window.stiffness
    square = np.square(window.lengths)
    moving = (~window.held)[:, None].astype(np.float64)

    def rate(time: float, state: np.ndarray) -> np.ndarray:
        displacement, velocity = state.reshape(2, -1, 3)
        stretch = window.difference @ displacement
        # l² − L² in displacement form loses no digits to the rest geometry.
        grown = np.einsum("ij,ij->i", 2 * window.edges + stretch, stretch)
        length = np.sqrt(np.maximum(square + grown, 1e-30))
        elongation = grown / (length + window.lengths)
        tension = scale * elongation
        if settings.nonlinearity:
            # At an elongation of 0.01 springs have grown (1 + β) times as stiff.
            tension *= 1 + settings.nonlinearity * np.square(elongation / 0.01)
        forces = -(transposed @ ((tension / length)[:, None] * (window.edges + stretch))) - damping * velocity
        loaded, shares = press.shares(window, time)
        push = force * force_factor(press.shape, np.asarray(time), press.load)
        forces[loaded] += push * np.outer(shares, window.press.direction)
        return np.stack((velocity * moving, forces * moving / settings.mass)).ravel()

    return rate
