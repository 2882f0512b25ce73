"""True motion of a synthetic scene: θ, the force in time, and the sheet's motion by an adaptive integrator.

The model is that of Bini 2026, section 3.3 (m ẍ + k_d ẋ + springs = F·n). The integrator is DOP853, an eighth-order
Runge-Kutta method with step control: another than the fitted scheme, which recovering θ so tests
(docs/reports/identifiability.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from scipy.ndimage import gaussian_filter

from palpate.data.synthetic.integration import STILL, Pressing, force_factor, integrate
from palpate.data.synthetic.passage import Passage
from palpate.data.synthetic.scene import Scene, SceneError, draw_contact_frames, draw_way
from palpate.data.synthetic.settings import SceneSettings
from palpate.physics.load import PressShape
from palpate.physics.mechanics import damping_ratio

SAMPLE_STEP = 0.005
"""Time between samples of the stored response: Δt of Bini 2026 [s]."""

Regime = Literal["under-damped", "critical", "over-damped"]
REGIMES: tuple[Regime, ...] = get_args(Regime)
"""All regimes, by rising damping ratio."""


@dataclass(frozen=True, kw_only=True)
class TrueMotion:
    """True motion of a clip's tissue under any model."""

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
        """Mask of the frames in which tool and tissue touch, shape [F], bool."""
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
        shape = replace(shape, radius=max(shape.radius, 3.0))  # the force is a Gaussian of half the radius
    times = np.linspace(0, loaded, 33)[1:]  # after release the tissue only swings back
    for _ in range(60):
        theta = draw_theta(settings, generator)
        *_, response = integrate(scene, Pressing(theta, loaded, shape, variation), times[-1:], times)
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
    shape: PressShape = PressShape(),  # noqa: B008 (frozen)
    travel: np.ndarray = STILL,
) -> PressedMotion:
    """Integrate the sheet from rest through press and release.

    Args:
        theta: [k_s, k_d, F].
        onset: first frame in contact.
        release: first frame after contact.
        variation: relative stiffness over the grid, shape [h, w]; None is 1 everywhere.
        delay, release_delay: from those frames' time stamps to the force's start and end, at most a frame interval [s].
        shape: shape of the press.
        travel: rows and columns by which the patch moves under load, shape [2] [grid px].

    Raises:
        SceneError: the force ends before it starts.
    """
    settings = scene.settings
    times = np.arange(settings.frames) / settings.fps
    load = (release - onset) / settings.fps + release_delay - delay
    if load <= 0:
        raise SceneError("The force ends before it starts; give a longer scene.press_seconds.")
    since = times - times[onset] - delay
    after, loaded = since[onset:], (since > -1e-9) & (since < load - 1e-9)
    fine = SAMPLE_STEP * np.arange(1, math.floor(after[-1] / SAMPLE_STEP + 1e-9) + 1)
    window, frames, response = integrate(scene, Pressing(theta, load, shape, variation, travel), after, fine)
    field = np.zeros((settings.frames, len(window.vertices), 3), np.float32)
    field[onset:] = frames
    way = np.clip(since / load, 0, 1)[:, None, None] * travel
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
        force=theta[2] * np.where(loaded, force_factor(shape, since, load), 0.0),
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
