"""True motion of a soft slab beneath the surface that a tool presses, or holds and moves.

Finite elements (`physics.fem`) of neo-Hookean material with inertia, held at the bottom and all around; some slabs have
a stiffer ball inside. The motion is damped in proportion to mass, or by a standard linear solid. No estimator fits this
law on this mesh. Lengths are scene units, and the unit of force is that of the other synthetic motions, so that E is in
that unit an area.
"""

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.random import Generator

from palpate.data.synthetic.grip import draw_course, draw_tip_path
from palpate.data.synthetic.scene import Scene, SceneError, require_room
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.truth import TrueMotion, draw_contact_frames, draw_shape, force_after, force_factor
from palpate.physics.fem import Inertia, Material, NoEquilibrium, Relaxation, find_equilibrium, simulate
from palpate.physics.fem.slab import Slab, crowded, layered
from palpate.physics.load import Grip, Load, Press

LAW = "neo_hookean"
"""Material law of the slab."""
SUBSTEPS = 2
"""Time steps a frame."""
TOLERANCE = 1e-7
"""Relative tolerance of the balance of forces in every time step."""
CELLS = (8, 8, 3)
"""Cells of quadratic elements along columns, rows and depth."""
HALF_WIDTH = 72 / 214
"""Distance from the contact to the slab's sides, as a share of the picture's width."""
GRIP_RADIUS = 11.5
"""Radius of the tissue between the jaws, around the contact [grid px]."""
BALL_RADIUS = (0.018, 0.03)
"""Range of the radius of an inclusion, drawn uniformly [scene units]."""


@dataclass(frozen=True)
class SlabTissue:
    """Material of a slab."""

    young: float
    """E outside the inclusion, of the slow branch where there is a relaxing one [force/scene unit²]."""
    poisson: float
    """Poisson's ratio ν."""
    density: float
    """Density [mass/scene unit³]."""
    thickness: float
    """Thickness [scene units]."""
    damping: float
    """Force per momentum, proportional to mass; 0 = none [1/s]."""
    branch: float
    """γ, stiffness of the relaxing branch divided by that of the slow one; 0 = none."""
    branch_time: float
    """Relaxation time τ of that branch [s]."""
    inclusion: float
    """E of a ball inside, divided by E around it; 1 = none."""
    stiffening: float
    """b of the law (`physics.fem.laws.respond`); 0 = it doesn't stiffen."""


@dataclass(frozen=True)
class SlabMotion(TrueMotion):
    """True motion of a clip whose tissue is a slab."""

    tissue: SlabTissue
    """Material of the slab."""

    @property
    def peak(self) -> float:
        """Largest displacement of the contact vertex at the frames' times [scene units]."""
        return float(np.linalg.norm(self.contact, axis=1).max())


@dataclass(frozen=True)
class PressedSlab(SlabMotion):
    """True motion of a slab that a tool presses with a force."""

    force: np.ndarray
    """Signed force at the frames' times, just after them, shape [F]."""


@dataclass(frozen=True)
class GrippedSlab(SlabMotion):
    """True motion of a slab that a tool holds from its first frame in contact to the clip's end."""

    course: np.ndarray
    """Offset of the tip from the contact vertex in the picture, shape [F, 2] [grid px]; 0 in contact."""
    reaction: np.ndarray
    """Force that holds the gripped tissue, along the picture's axes, shape [F, 2]."""


def draw_tissue(settings: SceneSettings, generator: Generator) -> SlabTissue:
    """Draw the material of a slab; ranges that begin above 0 are drawn log-uniformly, the others uniformly."""

    def drawn(value: float | tuple[float, float]) -> float:
        if not isinstance(value, tuple):
            return value
        return math.exp(generator.uniform(*np.log(value))) if value[0] > 0 else float(generator.uniform(*value))

    names = [field.name for field in fields(SlabTissue)]
    return SlabTissue(**{name: drawn(getattr(settings, f"slab_{name}")) for name in names})


def draw_slab(scene: Scene, generator: Generator) -> PressedSlab | GrippedSlab:
    """Draw a slab and its load, and integrate.

    Raises:
        SceneError: the surface bends too much for a slab below it, the tool has no room, the clip is too long, or
            elements turn inside out.
    """
    tissue = draw_tissue(scene.settings, generator)
    body = _build(scene, tissue)
    material = _material(body, scene, tissue, generator)
    try:
        draw = _press if scene.settings.action == "press" else _pull
        return draw(scene, body, material, tissue, generator)
    except NoEquilibrium as error:
        raise SceneError(f"The slab can't be followed: {error} Or choose a smaller scene.peak_displacement.") from error


def _build(scene: Scene, tissue: SlabTissue) -> Slab:
    """The slab under the surface around the contact, its sides along the contact's normal."""
    row, column = scene.mesh.pixels[scene.vertex].astype(float).tolist()
    wide, camera = HALF_WIDTH * scene.settings.grid_width, scene.grid_camera
    pixels, below, held = crowded(CELLS, (column, row), wide, tissue.thickness)
    x, y = (pixels[:, 0] - camera.cx) / camera.fx, (pixels[:, 1] - camera.cy) / camera.fy
    depth = scene.sheet.depth(x, y)
    nodes = np.stack([x * depth, y * depth, depth], axis=1) - below[:, None] * scene.direction
    if scene.settings.action == "press":  # outside its outline the organ is attached
        held |= scene.outline.level(*pixels.T) <= 0
    try:
        return layered(nodes, held, CELLS, pixels, (column, row), order=2)
    except ValueError as error:
        remedy = "choose a smaller scene.curvature, scene.relief or scene.slab_thickness"
        raise SceneError(f"Below this surface a slab folds ({error}); {remedy}.") from error


def _material(body: Slab, scene: Scene, tissue: SlabTissue, generator: Generator) -> Material:
    """The slab's material; the settings may ask for a ball of other stiffness obliquely beneath the contact."""
    radius, angle = generator.uniform(*BALL_RADIUS), generator.uniform(0, 2 * np.pi)
    offset = generator.uniform(0.3, 1.2) * radius
    if tissue.inclusion == 1:
        return Material(LAW, tissue.young, tissue.poisson, tissue.stiffening)
    # The ball's top is an eighth of the thickness below the surface.
    deep = min(radius + tissue.thickness / 8, tissue.thickness)
    middle = scene.mesh.vertices[scene.vertex] - deep * scene.direction
    middle = middle + offset * np.array([math.cos(angle), math.sin(angle), 0.0])
    centre = body.solid.rest[body.solid.elements[:, :4]].mean(axis=1)
    inside = np.linalg.norm(centre - middle, axis=1) < radius
    young = tissue.young * np.where(inside, tissue.inclusion, 1.0)
    return Material(LAW, young, tissue.poisson, tissue.stiffening)


def _follow(
    scene: Scene, body: Slab, material: Material, tissue: SlabTissue, load: Load, onset: int, force: float = 0.0
) -> tuple[dict, np.ndarray]:
    """Fields of a `SlabMotion` except the release, by name, and the reactions of every step [T, N, 3]."""
    settings = scene.settings
    row, column = scene.mesh.pixels.T
    across = (column > body.columns[0]) & (column < body.columns[-1])
    shown = np.flatnonzero(across & (row > body.rows[0]) & (row < body.rows[-1]))
    require_room(settings.frames * (len(shown) + load.steps // settings.frames * len(body.solid.rest)) * 3)
    relaxation = Relaxation(tissue.branch, tissue.branch_time) if tissue.branch else None
    step, inertia = 1 / (settings.fps * SUBSTEPS), Inertia(tissue.density, tissue.damping)
    found = simulate(
        body.solid, material, body.held, load, step, inertia=inertia, force=force, relaxation=relaxation,
        tolerance=TOLERANCE,
    )  # fmt: skip
    between = body.between(scene.mesh.pixels[shown])
    field = np.zeros((settings.frames, len(shown), 3), np.float32)
    for index, moved in enumerate(found.displacement[::SUBSTEPS]):
        field[onset + index] = between @ moved
    contact = field[:, np.searchsorted(shown, scene.vertex)].astype(np.float64)
    times = np.arange(settings.frames) / settings.fps
    known = {"onset_frame": onset, "times": times, "contact": contact, "moving": shown, "field": field}
    return {**known, "tissue": tissue}, found.reaction


def _press(scene: Scene, body: Slab, material: Material, tissue: SlabTissue, generator: Generator) -> PressedSlab:
    """Press the slab with the force that would reach a drawn displacement if the slab were linear."""
    settings = scene.settings
    onset, release = draw_contact_frames(settings, generator)
    wanted = generator.uniform(*settings.peak_displacement)
    load = (release - onset) / settings.fps
    shape = draw_shape(settings, load, generator.spawn(1)[0])
    direction = shape.leaning(scene.direction)
    shares = body.patch(max(shape.radius, 1.0))
    nodes = np.flatnonzero(shares)
    time = np.arange(1, SUBSTEPS * (settings.frames - 1 - onset) + 1) / (settings.fps * SUBSTEPS)
    pressed = time < load + 1e-9
    factor = np.where(pressed, force_factor(shape, time, load), 0.0)
    # A linear slab at rest sinks by `sunk` under a unit force.
    linear = Material("linear", material.young, material.poisson)
    soft = find_equilibrium(body.solid, linear, body.held, forces=shares[:, None] * direction).displacement
    sunk = body.between(scene.mesh.pixels[[scene.vertex]]) @ soft @ scene.direction
    force = -wanted / sunk.item()
    press = Press(nodes, shares[nodes], direction, factor)
    known, _ = _follow(scene, body, material, tissue, press, onset, force)
    after = known["times"] - known["times"][onset]
    return PressedSlab(**known, release_frame=release, force=force * force_after(shape, after, load))


def _pull(scene: Scene, body: Slab, material: Material, tissue: SlabTissue, generator: Generator) -> GrippedSlab:
    """Move the slab's gripped nodes along a drawn path."""
    settings = scene.settings
    onset = round(generator.uniform(*settings.onset_fraction) * settings.frames)
    path, course = draw_tip_path(scene, generator), draw_course(onset, settings, generator)
    apart = np.hypot(body.columns[:, None] - body.place[0], body.rows - body.place[1])
    nodes = body.top[apart < GRIP_RADIUS]
    steps = SUBSTEPS * (settings.frames - 1 - onset)
    if steps < 1:
        raise SceneError("The tool never holds the slab; give a smaller scene.onset_fraction.")
    targets = path(np.arange(1, steps + 1) / steps) * scene.spacing
    moved = np.concatenate([targets, np.zeros((steps, 1))], axis=1)
    grip = Grip(nodes, np.repeat(moved[:, None], len(nodes), axis=1))
    known, reaction = _follow(scene, body, material, tissue, grip, onset)
    holding = np.zeros((settings.frames, 2))
    holding[onset + 1 :] = reaction[SUBSTEPS - 1 :: SUBSTEPS, nodes, :2].sum(axis=1)
    return GrippedSlab(**known, release_frame=settings.frames, course=course, reaction=holding)
