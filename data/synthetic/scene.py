"""Geometry of a synthetic scene: the tissue sheet, the outline of the organ, contact vertex and entry of the tool.

The sheet is a smooth height field over the camera's rays. Its normal at the contact is within a few degrees of the line
of sight, so that the depth map shows a press. The true mesh is the grid mesh of the undeformed organ on the network's
grid, the very topology that is later fitted (docs/reports/identifiability.md).
"""

import math
from dataclasses import dataclass

import numpy as np

from palpate.data.source.camera import Camera, back_project
from palpate.data.synthetic.settings import SceneSettings
from palpate.physics.mesh import Mesh, contact_normal, grid_mesh

NEAREST_DEPTH, FARTHEST_DEPTH = 0.33, 0.95
"""Depths between which the whole sheet must lie [scene units]; above 1 the stored depth would saturate."""
CLEARANCE = 7.0
"""Distance of the tool from the organ in the frames next to contact, in the picture plane [grid px]."""


class SceneError(ValueError):
    """The settings leave no scene to draw; the message is a sentence that says what to change."""


def require_room(values: int) -> None:
    """Refuse a motion of more numbers than memory should hold, before it is integrated.

    Raises:
        SceneError: it takes more than 1 GB.
    """
    if (size := 8 * values / 2**30) > 1:
        problem = f"The motion of all frames takes {size:.1f} GB, more than 1"
        raise SceneError(f"{problem}; give fewer --frames, or a smaller grid.")


@dataclass(frozen=True)
class Sheet:
    """Undeformed tissue surface z(x, y) over the rays (x, y, 1)."""

    contact_ray: np.ndarray
    """(x, y) of the ray through the contact, shape [2]."""
    distance: float
    """Depth of the contact [scene units]."""
    normal: np.ndarray
    """Unit normal at the contact, towards the camera, shape [3]."""
    curvature: np.ndarray
    """Symmetric matrix of second derivatives of the relative depth, shape [2, 2]."""
    waves: np.ndarray
    """Amplitude, wave vector (2) and phase of each wave, shape [W, 4]."""

    def depth(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Depth z [scene units] along the rays (x, y, 1), any shape.

        A plane through the contact times (1 + h). As h and its gradient vanish at the contact, the plane's normal is
        the sheet's there.
        """
        ray = np.array([*self.contact_ray, 1.0])
        plane = self.distance * (self.normal @ ray) / (self.normal[0] * x + self.normal[1] * y + self.normal[2])
        dx, dy = x - self.contact_ray[0], y - self.contact_ray[1]
        (across, mixed), (_, down) = self.curvature
        height = 0.5 * (across * dx * dx + 2 * mixed * dx * dy + down * dy * dy)
        for amplitude, wave_x, wave_y, phase in self.waves:
            angle = wave_x * dx + wave_y * dy
            height = height + amplitude * (np.cos(angle + phase) - math.cos(phase) + math.sin(phase) * angle)
        return plane * (1 + height)


@dataclass(frozen=True)
class Outline:
    """Outline of the organ in the grid: an ellipse with a wobble."""

    center: np.ndarray
    """Centre (column, row), shape [2] [grid px]."""
    axes: np.ndarray
    """Half-axes along columns and rows, shape [2] [grid px]."""
    wobble: np.ndarray
    """Relative amplitude and phase of harmonics 2, 3, … of the radius, shape [K, 2]."""

    def level(self, column: np.ndarray, row: np.ndarray) -> np.ndarray:
        """Signed distance to the outline along the ray from the centre [grid px], positive inside."""
        dx, dy = column - self.center[0], row - self.center[1]
        return self.radius(np.arctan2(dy, dx)) - np.hypot(dx, dy)

    def radius(self, angle: np.ndarray) -> np.ndarray:
        """Distance of the outline from the centre in a direction [grid px]."""
        ellipse = 1 / np.hypot(np.cos(angle) / self.axes[0], np.sin(angle) / self.axes[1])
        return ellipse * (1 + sum(a * np.cos((k + 2) * angle + phase) for k, (a, phase) in enumerate(self.wobble)))


@dataclass(frozen=True)
class Scene:
    """A still scene before contact."""

    settings: SceneSettings
    """Settings from which the scene was drawn."""
    sheet: Sheet
    """Undeformed tissue surface."""
    outline: Outline
    """Outline of the organ on the grid."""
    camera: Camera
    """True camera of the full picture."""
    grid_camera: Camera
    """True camera of the grid."""
    mesh: Mesh
    """Undeformed organ on the grid, nothing hidden; for a grip, all tissue in the picture."""
    vertex: int
    """Contact vertex of the mesh."""
    direction: np.ndarray
    """Contact normal, shape [3], float64, towards the camera."""
    entry: np.ndarray
    """Unit vector in the picture from the contact to where the tool enters, shape [2]."""
    exit_offset: float
    """Distance along `entry` by which the tip must draw back to be clear of the organ [grid px]."""

    @property
    def spacing(self) -> float:
        """Size of a grid cell at the contact's depth [scene units]."""
        return self.sheet.distance / self.grid_camera.fx


Place = tuple[np.ndarray, Outline, tuple[int, int]]
"""Entry of the tool, outline of the organ, and grid pixel (column, row) of the contact."""


def draw_scene(settings: SceneSettings, generator: np.random.Generator) -> Scene:
    """Draw a scene.

    Raises:
        SceneError: no draw keeps the sheet within depths 0.33 to 0.95 and the contact on the organ.
    """
    camera = Camera.from_field_of_view(settings.field_of_view_deg, settings.width, settings.height)
    grid_camera = camera.scaled(settings.grid_width, settings.grid_height)
    columns, rows = np.meshgrid(np.arange(settings.grid_width), np.arange(settings.grid_height))
    rays = (columns - grid_camera.cx) / grid_camera.fx, (rows - grid_camera.cy) / grid_camera.fy
    filled = settings.view == "filled"
    place = _draw_filled if filled else _draw_island
    for _ in range(200):
        entry, outline, (column, row) = place(settings, generator)
        contact_ray = np.array([(column - grid_camera.cx) / grid_camera.fx, (row - grid_camera.cy) / grid_camera.fy])
        sheet = _draw_sheet(settings, contact_ray, generator)
        depth = sheet.depth(*rays)
        if not (depth.min() > NEAREST_DEPTH and depth.max() < FARTHEST_DEPTH):
            continue
        # The motion that a grip causes spreads to tissue outside the organ.
        tissue = (outline.level(columns, rows) > 0) | (settings.action == "grip") | (settings.masked == "all")
        mesh = grid_mesh(back_project(depth, grid_camera), tissue)
        vertices = np.flatnonzero((mesh.pixels == (row, column)).all(axis=1))
        exit_offset = 0.0 if filled else _exit_offset(outline, (column, row), entry)
        if len(vertices) == 1 and not mesh.rim[vertices[0]] and exit_offset < 0.3 * settings.grid_width:
            vertex = int(vertices[0])
            normal = contact_normal(mesh, vertex)
            return Scene(settings, sheet, outline, camera, grid_camera, mesh, vertex, normal, entry, exit_offset)
    raise SceneError(
        f"scene.distance {settings.distance} with scene.curvature {settings.curvature} and scene.max_tilt_deg "
        f"{settings.max_tilt_deg} leaves the depths {NEAREST_DEPTH} to {FARTHEST_DEPTH}; choose smaller ones."
    )


def draw_contact_frames(settings: SceneSettings, generator: np.random.Generator) -> tuple[int, int]:
    """First frame in contact, and the first after it.

    Raises:
        SceneError: the clip is too short for them.
    """
    onset = max(1, round(generator.uniform(*settings.onset_fraction) * settings.frames))
    load = max(1, round(generator.uniform(*settings.press_seconds) * settings.fps))
    if onset + load > settings.frames - 2:
        raise SceneError(
            f"{settings.frames} frames at {settings.fps:g} a second end before the tool is released; give scene.frames "
            f"at least {onset + load + 2} or a shorter scene.press_seconds."
        )
    return onset, onset + load


def project(points: np.ndarray, camera: Camera) -> np.ndarray:
    """Columns and rows of points [..., 3] in the picture, shape [..., 2] [px]."""
    return points[..., :2] / points[..., 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]


def draw_way(scene: Scene, name: str, unit: float, generator: np.random.Generator) -> np.ndarray:
    """Draw a straight way over the tissue from the contact, columns and rows, shape [2] [grid px].

    Args:
        name: setting with the range of its length.
        unit: grid px in a unit of the setting.

    Raises:
        SceneError: it would leave the tissue or the picture.
    """
    size, lengths = np.array(scene.mesh.grid_shape[::-1]), getattr(scene.settings, name)
    inner = np.zeros(scene.mesh.grid_shape, bool)
    inner[tuple(scene.mesh.pixels[~scene.mesh.rim].T)] = True
    for _ in range(100):
        far = generator.uniform(*lengths) / unit * _direction(generator.uniform(0, 2 * np.pi))
        end = scene.mesh.pixels[scene.vertex, ::-1] + far
        # The tip stays 12 grid px inside the picture.
        if np.minimum(end, size - end).min() > 12.0 and inner[tuple(np.rint(end[::-1]).astype(int))]:
            return far
    raise SceneError(f"scene.{name} {lengths} leaves the picture; choose smaller.")


def crop_mesh(mesh: Mesh, vertex: int, reach: int) -> tuple[Mesh, np.ndarray, np.ndarray]:
    """The part of a grid mesh within `reach` pixels of a vertex, its cut edge held.

    Returns:
        The part, without triangles; the indices of its vertices, ascending, and whether they lie on the cut, shape [N]
        each.
    """
    apart = np.abs(mesh.pixels - mesh.pixels[vertex]).max(axis=1)
    kept = np.flatnonzero(apart <= reach)
    number = np.full(len(mesh.vertices), -1, np.int32)
    number[kept] = np.arange(len(kept))
    springs = number[mesh.springs]
    cut = apart[kept] == reach
    cropped = Mesh(
        vertices=mesh.vertices[kept],
        triangles=np.empty((0, 3), np.int32),
        springs=springs[(springs >= 0).all(axis=1)],
        rim=mesh.rim[kept] | cut,
        pixels=mesh.pixels[kept],
        grid_shape=mesh.grid_shape,
    )
    return cropped, kept, cut


def _draw_island(settings: SceneSettings, generator: np.random.Generator) -> Place:
    # Within 20° of a grid axis: only then one tissue pixel lies in front of the tool's tip.
    base = generator.choice([0.0, 180.0, -90.0, 90.0], p=[0.35, 0.35, 0.15, 0.15])
    entry = _direction(math.radians(base + generator.uniform(-20, 20)))
    size = np.array([settings.grid_width, settings.grid_height])
    axes = size * generator.uniform([0.30, 0.36], [0.36, 0.42])
    # The centre is shifted away from the tool's entry, so that the tool has room to appear clear of the organ.
    center = (size - 1) / 2 - entry * size * 0.07 + generator.uniform(-1, 1, 2) * size * 0.02
    outline = Outline(center, axes, _draw_wobble(generator))
    # The contact is a little inside the outline on the tool's side.
    angle = math.atan2(entry[1], entry[0]) + math.radians(generator.uniform(-25, 25))
    reach = float(outline.radius(np.array(angle))) - generator.uniform(12, 20)
    column, row = outline.center + reach * _direction(angle)
    return entry, outline, (round(float(column)), round(float(row)))


def _draw_filled(settings: SceneSettings, generator: np.random.Generator) -> Place:
    """Organ of any place and size that holds the contact, which lies in the picture's middle three fifths."""
    size = np.array([settings.grid_width, settings.grid_height])
    contact = np.rint(size * generator.uniform(0.2, 0.8, 2))
    axes = size * generator.uniform(0.3, 0.7, 2)
    center = contact + axes * generator.uniform(0, 0.7) * _direction(generator.uniform(0, 2 * np.pi))
    outline = Outline(center, axes, _draw_wobble(generator))
    return _direction(generator.uniform(0, 2 * np.pi)), outline, (int(contact[0]), int(contact[1]))


def _draw_wobble(generator: np.random.Generator) -> np.ndarray:
    return np.stack((generator.uniform(0, [0.05, 0.04, 0.03]), generator.uniform(0, 2 * np.pi, 3)), axis=1)


def _direction(angle: float) -> np.ndarray:
    return np.array([math.cos(angle), math.sin(angle)])


def _draw_sheet(settings: SceneSettings, contact_ray: np.ndarray, generator: np.random.Generator) -> Sheet:
    distance = generator.uniform(*settings.distance)
    bends = generator.uniform(*settings.curvature, size=2)
    turn = generator.uniform(0, np.pi)
    axes = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    angles = generator.uniform(0, 2 * np.pi, size=(5, 2))
    lengths = generator.uniform(4, 11, size=5)
    amplitudes = settings.relief * generator.uniform(0.3, 1, size=5) * 4 / lengths
    waves = np.stack((amplitudes, lengths * np.cos(angles[:, 0]), lengths * np.sin(angles[:, 0]), angles[:, 1]), axis=1)
    tilt = math.radians(settings.max_tilt_deg) * math.sqrt(generator.uniform())
    azimuth = generator.uniform(0, 2 * np.pi)
    towards = -np.array([*contact_ray, 1.0]) / np.linalg.norm([*contact_ray, 1.0])  # the camera
    first = np.cross(towards, [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    side = math.cos(azimuth) * first + math.sin(azimuth) * np.cross(towards, first)
    normal = math.cos(tilt) * towards + math.sin(tilt) * side
    return Sheet(contact_ray, distance, normal, axes @ np.diag(bends) @ axes.T, waves)


def _exit_offset(outline: Outline, contact: tuple[int, int], entry: np.ndarray) -> float:
    """Smallest draw-back along the entry beyond which the tip stays clear of the organ [grid px]."""
    offsets = np.arange(0.0, 200.0, 0.5)
    positions = np.asarray(contact) + offsets[:, None] * entry
    inside = np.flatnonzero(outline.level(*positions.T) > -CLEARANCE)
    return float(offsets[inside[-1]] + 0.5)
