"""True motion of a synthetic scene: θ, the force in time, and the sheet's motion by an adaptive integrator.

The model is that of Bini 2026, section 3.3 (m ẍ + k_d ẋ + springs = F·n). The integrator is another one, DOP853, an
eighth-order Runge-Kutta method with step control, so that recovering θ with the fitted scheme is a test of that scheme
(see docs/reports/identifiability.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, get_args

import numpy as np
from scipy.integrate import solve_ivp
from scipy.ndimage import gaussian_filter
from scipy.sparse import csr_array

from palpate.data.synthetic.passage import Passage
from palpate.data.synthetic.scene import Scene, SceneError, crop_mesh, draw_contact_frames, draw_way, require_room
from palpate.data.synthetic.settings import SceneSettings
from palpate.physics.load import Press, PressShape
from palpate.physics.mechanics import damping_ratio
from palpate.physics.mesh import Mesh, incidence

SAMPLE_STEP = 0.005
"""Time between samples of the stored response: Δt of Bini 2026 [s]."""
RELATIVE_TOLERANCE, ABSOLUTE_TOLERANCE = 1e-6, 1e-9
"""Local error of the integrator; positions come out within about 1e-6 scene units."""
TIME_TOLERANCE = 1e-9
"""Times closer than this are equal [s]."""
STEP = PressShape()
"""The simplest press: on a vertex, at once."""
STILL = np.zeros(2)
"""No travel."""
LEAST_SLIDING = 3.0
"""Least radius of a patch that slides [grid px]; its force is a Gaussian of half the radius, which moves smoothly."""

Regime = Literal["under-damped", "critical", "over-damped"]
REGIMES: tuple[Regime, ...] = get_args(Regime)
"""All regimes, by rising damping ratio."""


@dataclass(frozen=True, kw_only=True)
class TrueMotion:
    """True motion of a clip's tissue, whatever its model."""

    onset_frame: int
    """First frame in contact, before which the tissue is at rest; the number of frames where there is none."""
    release_frame: int
    """First frame after contact."""
    times: np.ndarray
    """Time stamps of the frames [s], shape [F]."""
    touched: np.ndarray
    """Mesh vertex that the tool touches, if it does, in every frame, shape [F]: the contact vertex unless it slides."""
    contact: np.ndarray
    """Displacement of those vertices at the frames' times, shape [F, 3] [scene units]."""
    moving: np.ndarray
    """Mesh vertices that the simulation covers, shape [M], int64."""
    field: np.ndarray
    """Displacement of those vertices at the frames' times, shape [F, M, 3], float32."""
    patch_radius: float = 0.0
    """Radius of the patch that a tool in contact acts on [grid px]; 0 is one vertex."""
    passage: Passage | None = None
    """The tool of a filled view."""

    @property
    def in_contact(self) -> np.ndarray:
        """Whether tool and tissue touch in each frame, shape [F], bool."""
        frame = np.arange(len(self.times))
        return (frame >= self.onset_frame) & (frame < self.release_frame)


@dataclass(frozen=True, kw_only=True)
class PressedMotion(TrueMotion):
    """True motion of a sheet that a tool presses with a force."""

    theta: np.ndarray
    """[k_s, k_d, F], float64, F signed."""
    delay: float
    """Time from the first frame in contact to the start of the force [s], at most a frame interval."""
    release_delay: float
    """Time from the first frame after contact to the end of the force [s], at most a frame interval."""
    response: np.ndarray
    """Displacement of the contact vertex every 5 ms from the start of the force on, the first 5 ms after it, shape
    [R, 3]."""
    force: np.ndarray
    """Signed force at the frames' times, just after them, shape [F]."""
    shape: PressShape
    """Patch, direction and time course of the force."""

    @property
    def load_seconds(self) -> float:
        """Time under load [s]."""
        stamped = self.times[self.release_frame] - self.times[self.onset_frame]
        return float(stamped + self.release_delay - self.delay)

    @property
    def peak(self) -> float:
        """Largest displacement of the contact vertex, at 5 ms resolution [scene units]."""
        return float(np.linalg.norm(self.response, axis=1).max())


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


def regime_of(zeta: float) -> Regime:
    """Regime of a damping ratio, with the limits of the tables in docs/reports/identifiability.md."""
    return "under-damped" if zeta < 0.7 else "critical" if zeta <= 1.4 else "over-damped"


def draw_theta(settings: SceneSettings, generator: np.random.Generator) -> np.ndarray:
    """Draw θ [k_s, k_d, F] log-uniformly from the settings' ranges, shape [3], until it has the wanted regime.

    Raises:
        SceneError: the ranges hold (almost) no θ of that regime.
    """
    for _ in range(10_000):
        stiffness, damping = (math.exp(generator.uniform(*np.log(r))) for r in (settings.stiffness, settings.damping))
        force = -math.exp(generator.uniform(math.log(-settings.force[1]), math.log(-settings.force[0])))
        if settings.regime in ("any", regime_of(damping_ratio(stiffness, damping, settings.mass))):
            return np.array([stiffness, damping, force])
    raise SceneError(
        f"scene.stiffness {settings.stiffness} and scene.damping {settings.damping} hold no {settings.regime} tissue; "
        "widen them or choose another scene.regime."
    )


def draw_motion(scene: Scene, generator: np.random.Generator) -> PressedMotion:
    """Draw θ and the time course, and integrate; draws whose peak is outside the wanted range are drawn again.

    Raises:
        SceneError: no draw of 60 reaches the wanted displacement.
    """
    settings = scene.settings
    low, high = settings.peak_displacement
    onset, release = draw_contact_frames(settings, generator)
    variation = _stiffness_field(settings, generator)
    # The delays have random streams of their own, so that θ and the frames of contact don't depend on them.
    ranges = settings.onset_delay, settings.release_delay
    streams, loaded = generator.spawn(2), (release - onset) / settings.fps
    delays = [float(stream.uniform(*share)) / settings.fps for stream, share in zip(streams, ranges, strict=True)]
    shape = draw_shape(settings, loaded + delays[1] - delays[0], generator.spawn(1)[0])
    travel, peaks = STILL, []
    if settings.action == "slide":
        travel = draw_way(scene, "travel", 1.0, generator)[::-1]
        shape = replace(shape, radius=max(shape.radius, LEAST_SLIDING))
    times = np.linspace(0, loaded, 33)[1:]  # after release the tissue only swings back
    for _ in range(60):
        theta = draw_theta(settings, generator)
        *_, response = _integrate(scene, _Pressing(theta, loaded, shape, variation), times[-1:], times)
        peaks.append(float(np.linalg.norm(response, axis=1).max()))
        if low <= peaks[-1] <= high:
            return simulate_motion(scene, theta, onset, release, variation, *delays, shape, travel)
    raise SceneError(
        f"scene.force {settings.force} moves the contact by {min(peaks):.2g} to {max(peaks):.2g}, outside "
        f"scene.peak_displacement [{low:g}, {high:g}]; change one of them."
    )


def simulate_motion(
    scene: Scene,
    theta: np.ndarray,
    onset: int,
    release: int,
    variation: np.ndarray | None = None,
    delay: float = 0.0,
    release_delay: float = 0.0,
    shape: PressShape = STEP,
    travel: np.ndarray = STILL,
) -> PressedMotion:
    """Integrate the sheet from rest through press and release.

    Args:
        theta: [k_s, k_d, F].
        onset: first frame in contact.
        release: first frame after contact.
        variation: relative stiffness over the grid, shape [h, w]; None is 1 everywhere.
        delay, release_delay: from those frames' time stamps to the start and the end of the force [s], at most a frame
            interval each.
        shape: of the press.
        travel: rows and columns by which the patch moves under load, shape [2] [grid px].

    Raises:
        SceneError: the force ends before it starts.
    """
    settings = scene.settings
    times = np.arange(settings.frames) / settings.fps
    load = (release - onset) / settings.fps + release_delay - delay
    if load <= 0:
        raise SceneError("The force ends before it starts; give a longer scene.press_seconds.")
    after = times[onset:] - times[onset] - delay  # since the start of the force
    fine = SAMPLE_STEP * np.arange(1, math.floor(after[-1] / SAMPLE_STEP + 1e-9) + 1)
    window, frames, response = _integrate(scene, _Pressing(theta, load, shape, variation, travel), after, fine)
    field = np.zeros((settings.frames, len(window.vertices), 3), np.float32)
    field[onset:] = frames
    way = np.clip((times - times[onset] - delay) / load, 0, 1)[:, None, None] * travel
    apart = np.linalg.norm(window.mesh.pixels - window.mesh.pixels[window.contact] - way, axis=2)
    touched, contact = apart.argmin(axis=1), np.zeros((settings.frames, 3))
    contact[onset:] = frames[np.arange(len(frames)), touched[onset:]]
    return PressedMotion(
        theta=theta,
        onset_frame=onset,
        release_frame=release,
        delay=delay,
        release_delay=release_delay,
        times=times,
        touched=window.vertices[touched],
        contact=contact,
        response=response,
        force=theta[2] * force_after(shape, times - times[onset] - delay, load),
        shape=shape,
        patch_radius=shape.radius,
        moving=window.vertices,
        field=field,
    )


def _stiffness_field(settings: SceneSettings, generator: np.random.Generator) -> np.ndarray | None:
    """Relative stiffness over the grid, log-normal and smooth, or None where it does not vary."""
    white = generator.standard_normal((settings.grid_height, settings.grid_width))
    if settings.stiffness_variation == 0:
        return None
    # Correlation length of the spring-to-spring variation.
    smooth = gaussian_filter(white, 6.0, mode="wrap")
    return np.exp(settings.stiffness_variation * smooth / smooth.std())


def draw_shape(settings: SceneSettings, load: float, generator: np.random.Generator) -> PressShape:
    """Shape of a press that lasts for `load` [s], drawn as the settings state."""
    ranges = settings.patch_radius, settings.force_tilt_deg, settings.rise, settings.fall
    radius, tilt, rise, fall = (float(generator.uniform(*ends)) for ends in ranges)
    angle = generator.uniform(0, 2 * math.pi)
    lean = math.tan(math.radians(tilt))
    course = {"step": (0.0, 0.0), "ramp": (load, 0.0), "hold": (rise * load, fall * load)}[settings.profile]
    return PressShape(radius, (0.0, 0.0), *course, (lean * math.cos(angle), lean * math.sin(angle)))


def force_factor(shape: PressShape, time: np.ndarray, load: float) -> np.ndarray:
    """Force at a time since its start as a share of F, for times within the load, whose end is `load` [s]."""
    risen = np.clip(time / shape.rise, 0.0, 1.0) if shape.rise else np.ones_like(time)
    left = np.clip((load - time) / shape.fall, 0.0, 1.0) if shape.fall else np.ones_like(time)
    return np.minimum(risen, left)


def force_after(shape: PressShape, time: np.ndarray, load: float) -> np.ndarray:
    """Return the force factor just after any times, 0 outside the load."""
    loaded = (time > -TIME_TOLERANCE) & (time < load - TIME_TOLERANCE)
    return np.where(loaded, force_factor(shape, time, load), 0.0)


class _Pressing(NamedTuple):
    """What is integrated."""

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


def _integrate(
    scene: Scene, press: _Pressing, coarse: np.ndarray, fine: np.ndarray
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


def _solve(scene: Scene, window: MeshWindow, press: _Pressing, times: np.ndarray) -> np.ndarray:
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


def _rate(settings: SceneSettings, window: MeshWindow, press: _Pressing, force: float):
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
