"""The grasper of a synthetic scene: a shaft with two jaws that enters from the picture's border.

It is drawn in coordinates along and across its axis. Its tip ends just before the contact vertex, which stays in view.
Away from the tip it keeps clear of the tissue, so that the tip is the nearest point.
"""

from __future__ import annotations

import math

import numpy as np

from palpate.data.masks.class_table import CLASSES
from palpate.data.synthetic.grip import GrippedMotion
from palpate.data.synthetic.passage import SHAFT_RADIUS, Passage
from palpate.data.synthetic.scene import Scene, project
from palpate.data.synthetic.surface import SheetView
from palpate.data.synthetic.truth import TrueMotion

EXPOSURE_DISTANCE = 0.5
"""Distance at which a white surface facing the light is at full scale [scene units]."""
TIP_START = 0.5
"""Distance along the axis from the contact vertex to where the tool begins [grid px]."""
TIP_GAP = 0.3
"""Gap between the tip and the contact vertex along the line of sight [cells of the contact's depth]."""
HALF_WIDTHS = ((0.0, 1.6), (2.0, 1.6), (7.0, 3.6), (16.0, 4.6), (19.0, 5.4), (21.0, 5.4))
"""Half-width [grid px] against the distance along the axis: tip, jaws, joint; the shaft follows."""

Tool = tuple[tuple[np.ndarray, np.ndarray], np.ndarray, np.ndarray]
"""Rows and columns of a tool's P pixels, z [P] [scene units], and light before its falloff with distance [P, 3]."""


def paint(tool: Tool, labels: np.ndarray, light: np.ndarray, depth: np.ndarray) -> None:
    """Draw a tool into class codes [H, W], linear light [H, W, 3] and depth [H, W] [scene units], in place.

    Fat hides the tool where it is nearer.
    """
    pixels, near, shade = tool
    kept = (labels[pixels] != CLASSES["fat"].grey) | (near < depth[pixels])
    pixels, near = (pixels[0][kept], pixels[1][kept]), near[kept]
    labels[pixels], depth[pixels] = CLASSES["grasper"].grey, near
    light[pixels] = shade[kept] * np.square(EXPOSURE_DISTANCE / near)[:, None]


def tip_offset(scene: Scene, motion: TrueMotion, frame: int) -> np.ndarray:
    """Offset of the tip from the contact vertex in the picture, shape [2] [grid px]; 0 exactly in frames in contact.

    A tool that presses draws back along its entry, out of the organ.
    """
    if isinstance(motion, GrippedMotion):
        return motion.course[frame]
    if motion.in_contact[frame]:
        return np.zeros(2)
    away = motion.onset_frame - 1 - frame if frame < motion.onset_frame else frame - motion.release_frame
    return (scene.exit_offset + min(5.0 * away, 60.0)) * scene.entry


def draw_tool(scene: Scene, motion: TrueMotion, frame: int, view: SheetView, rays: np.ndarray) -> Tool:
    """Pixels, depth and brightness of the tool in a frame.

    Args:
        rays: ray of every pixel, its z is 1, shape [H, W, 3].
    """
    if motion.passage is not None:
        return _draw_passage(scene, motion.passage, frame, view, rays)
    camera, settings = scene.camera, scene.settings
    offset, touching = tip_offset(scene, motion, frame), bool(motion.in_contact[frame])
    clearance = 0.03  # of a tool that doesn't touch the tissue [scene units]
    vertex = scene.mesh.vertices[scene.vertex] + motion.contact[frame]
    contact = project(vertex, camera)
    tip_depth = vertex[2] if touching else vertex[2] - clearance
    columns = (np.arange(camera.width) - contact[0]) / settings.cell[0] - offset[0]
    rows = (np.arange(camera.height) - contact[1]) / settings.cell[1] - offset[1]
    along = columns * scene.entry[0] + rows[:, None] * scene.entry[1]
    across = rows[:, None] * scene.entry[0] - columns * scene.entry[1]
    # Inverse depth grows towards the entry: a straight line in space.
    axis_depth = tip_depth / np.maximum(1 + 0.006 * along, 0.5)
    # Jaws and joint of narrow pictures must not outgrow the shaft.
    shaft = SHAFT_RADIUS * scene.grid_camera.fx / axis_depth
    half_width = np.where(along < HALF_WIDTHS[-1][0], np.minimum(jaw_width(along), shaft), shaft)
    row, column = np.nonzero((along >= TIP_START) & (np.abs(across) <= half_width))
    along, across, axis_depth, half_width = (a[row, column] for a in (along, across, axis_depth, half_width))
    section = across / half_width
    bulge = np.sqrt(1 - np.square(section))
    depth = axis_depth - half_width * bulge * axis_depth / scene.grid_camera.fx
    # The tool rises from the tissue along and across its axis, behind a keel that follows the vertex into its dent.
    keel_length, keel_width = 1.8, 0.8
    rise = 2.0 * (np.maximum(along - keel_length, 0) + np.abs(across))
    gap = np.minimum((TIP_GAP + rise) * scene.spacing, 0.035) if touching else clearance
    depth = np.minimum(depth, view.depth[row, column] - gap)
    if touching:
        keel = (along <= keel_length) & (np.abs(across) <= keel_width)
        depth[keel] = tip_depth - (TIP_GAP + 0.3 * np.abs(across[keel])) * scene.spacing
    return (row, column), depth.astype(np.float32), _light(along, across, section, bulge)


def _draw_passage(scene: Scene, passage: Passage, frame: int, view: SheetView, rays: np.ndarray) -> Tool:
    length = np.linalg.norm(rays, axis=-1)
    reach, apart, radius, along, sine = passage.crossed(frame, np.zeros(3), rays / length[..., None])
    bulge = np.sqrt(np.maximum(1 - np.square(apart / radius), 0))
    depth = (reach - radius * bulge / sine) / length
    row, column = np.nonzero((apart < radius) & (reach > 0))
    apart, radius, along, bulge = (part[row, column] for part in (apart, radius, along, bulge))
    section = np.sign(rays[row, column] @ np.cross(passage.axis, passage.tip[frame])) * apart / radius
    jaws = along * (HALF_WIDTHS[-1][0] / passage.cone)
    light = _light(jaws, section * radius / scene.spacing, section, bulge)
    # A dent is narrower than the tool, which would be inside the tissue around it.
    depth = np.minimum(depth, view.depth - TIP_GAP * scene.spacing)[row, column]
    return (row, column), depth.astype(np.float32), light


def jaw_width(along: np.ndarray) -> np.ndarray:
    """Half-width of jaws and joint at places along their axis [grid px]."""
    return np.interp(along, *np.array(HALF_WIDTHS).T)


def _light(along: np.ndarray, across: np.ndarray, section: np.ndarray, bulge: np.ndarray) -> np.ndarray:
    """Brushed metal: a cylinder lit from the camera, with a bright streak, a dark slit between the jaws and rings."""
    joint = HALF_WIDTHS[-1][0]
    jaws = along < joint
    grey = np.where(jaws, 0.42, 0.13) * (0.25 + 0.75 * bulge)
    streak = np.exp(-0.5 * np.square((section - 0.25) / 0.12)) + 0.5 * np.exp(-0.5 * np.square((section + 0.45) / 0.1))
    grey += np.where(jaws, 0.5, 0.28) * streak
    grey[(along > 4) & (along < 15) & (np.abs(across) < 0.5)] = 0.02
    # The jaws have teeth, and a ring marks where the shaft begins.
    grey *= np.where((along > 3) & (along < 15), 1 - 0.15 * (np.sin(2 * math.pi * along / 1.3) > 0), 1.0)
    grey[np.abs(along - joint) < 0.6] *= 0.35
    return grey[:, None] * np.array([0.98, 1.0, 1.03])
