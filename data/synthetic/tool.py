"""The grasper of a synthetic scene: a shaft with two jaws that enters from the picture's border.

It is drawn in coordinates along and across its axis. Its tip ends just before the contact vertex, so that the vertex
stays in view, and away from the tip it keeps clear of the tissue, so that the tip is the nearest point.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from data.synthetic.grip import GrippedMotion
from data.synthetic.scene import Scene
from data.synthetic.slab import GrippedSlab
from data.synthetic.surface import View
from data.synthetic.truth import Motion

SHAFT_RADIUS = 0.021
"""Radius of the shaft [scene units]."""
TIP_START = 0.5
"""Where the tool begins, before the contact vertex [grid px]."""
TIP_GAP = 0.3
"""Gap between the tip and the contact vertex along the line of sight [cells of the contact's depth]."""
GAP_SLOPE = 2.0
"""How fast the tool rises from the tissue along and across its axis [cells a grid px]."""
KEEL_LENGTH, KEEL_WIDTH = 1.8, 0.8
"""Part of the tip that follows the contact vertex into its dent [grid px]."""
LARGEST_GAP = 0.035
"""Clearance of the jaws from the tissue that the rise stops at [scene units]."""
LIFT = 0.03
"""Clearance of the tool when it is not in contact [scene units]."""
AXIS_SLOPE = 0.006
"""Growth of inverse depth towards the entry, a grid px, relative to the tip's: a straight line in space."""
APPROACH, FARTHEST_RETREAT = 5.0, 60.0
"""Speed [grid px a frame] away from contact, and how far the tool draws back."""
WIDTHS = ((0.0, 1.6), (2.0, 1.6), (7.0, 3.6), (16.0, 4.6), (19.0, 5.4), (21.0, 5.4))
"""Half-width [grid px] against the distance along the axis: tip, jaws, joint; the shaft follows."""
SLIT = (4.0, 15.0, 0.5)
"""Where the two jaws show a gap: from, to, half-width [grid px]."""


@dataclass(frozen=True)
class Tool:
    """Pixels of the tool in one frame."""

    rows: np.ndarray
    """Rows of its pixels, shape [P]."""
    columns: np.ndarray
    """Columns of its pixels, shape [P]."""
    depth: np.ndarray
    """z, shape [P] [scene units]."""
    light: np.ndarray
    """Reflected light on the way back to the camera before the distance's falloff, shape [P, 3], linear RGB."""

    def seen(self, bare: np.ndarray, depth: np.ndarray) -> Tool:
        """The pixels that are bare of other things, shape [H, W], or nearer to the camera than their depth [H, W]."""
        pixels = self.rows, self.columns
        seen = bare[pixels] | (self.depth < depth[pixels])
        return Tool(self.rows[seen], self.columns[seen], self.depth[seen], self.light[seen])


def tip_offset(scene: Scene, motion: Motion, frame: int) -> np.ndarray:
    """The tip from the contact vertex in the picture, shape [2] [grid px]; 0 exactly in the frames of contact.

    A tool that presses draws back along its entry, out of the organ.
    """
    if isinstance(motion, GrippedMotion | GrippedSlab):
        return motion.course[frame]
    if motion.in_contact[frame]:
        return np.zeros(2)
    away = motion.onset_frame - 1 - frame if frame < motion.onset_frame else frame - motion.release_frame
    return (scene.exit_offset + min(APPROACH * away, FARTHEST_RETREAT)) * scene.entry


def draw_tool(scene: Scene, motion: Motion, frame: int, view: View) -> Tool:
    """Pixels, depth and brightness of the tool in a frame."""
    camera, settings = scene.camera, scene.settings
    offset, touching = tip_offset(scene, motion, frame), bool(motion.in_contact[frame])
    vertex = scene.mesh.vertices[scene.vertex] + motion.contact[frame]
    contact = vertex[:2] / vertex[2] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    tip_depth = vertex[2] if touching else vertex[2] - LIFT
    columns = (np.arange(camera.width) - contact[0]) / settings.cell[0] - offset[0]
    rows = (np.arange(camera.height) - contact[1]) / settings.cell[1] - offset[1]
    along = columns * scene.entry[0] + rows[:, None] * scene.entry[1]
    across = rows[:, None] * scene.entry[0] - columns * scene.entry[1]
    axis_depth = tip_depth / np.maximum(1 + AXIS_SLOPE * along, 0.5)
    half_width = _half_width(along, SHAFT_RADIUS * scene.grid_camera.fx / axis_depth)
    row, column = np.nonzero((along >= TIP_START) & (np.abs(across) <= half_width))
    along, across, axis_depth, half_width = (a[row, column] for a in (along, across, axis_depth, half_width))
    section = across / half_width
    bulge = np.sqrt(1 - np.square(section))
    depth = axis_depth - half_width * bulge * axis_depth / scene.grid_camera.fx
    rise = GAP_SLOPE * (np.maximum(along - KEEL_LENGTH, 0) + np.abs(across))
    gap = np.minimum((TIP_GAP + rise) * scene.spacing, LARGEST_GAP) if touching else LIFT
    depth = np.minimum(depth, view.depth[row, column] - gap)
    if touching:
        keel = (along <= KEEL_LENGTH) & (np.abs(across) <= KEEL_WIDTH)
        depth[keel] = tip_depth - (TIP_GAP + 0.3 * np.abs(across[keel])) * scene.spacing
    return Tool(row, column, depth.astype(np.float32), _light(along, across, section, bulge))


def _half_width(along: np.ndarray, shaft: np.ndarray) -> np.ndarray:
    """Half-width of the tool [grid px] along its axis; `shaft` is the shaft's there."""
    # Jaws and joint of narrow pictures must not outgrow the shaft.
    return np.where(along < WIDTHS[-1][0], np.minimum(jaw_width(along), shaft), shaft)


def jaw_width(along: np.ndarray) -> np.ndarray:
    """Half-width of jaws and joint at places along their axis [grid px]."""
    return np.interp(along, *np.array(WIDTHS).T)


def _light(along: np.ndarray, across: np.ndarray, section: np.ndarray, bulge: np.ndarray) -> np.ndarray:
    """Brushed metal: a cylinder lit from the camera, with a bright streak, a dark slit between the jaws and rings."""
    joint = WIDTHS[-1][0]
    jaws = along < joint
    grey = np.where(jaws, 0.42, 0.13) * (0.25 + 0.75 * bulge)
    streak = np.exp(-0.5 * np.square((section - 0.25) / 0.12)) + 0.5 * np.exp(-0.5 * np.square((section + 0.45) / 0.1))
    grey += np.where(jaws, 0.5, 0.28) * streak
    start, stop, width = SLIT
    grey[(along > start) & (along < stop) & (np.abs(across) < width)] = 0.02
    # Teeth on the jaws, a ring where the shaft begins.
    grey *= np.where((along > 3) & (along < stop), 1 - 0.15 * (np.sin(2 * math.pi * along / 1.3) > 0), 1.0)
    grey[np.abs(along - joint) < 0.6] *= 0.35
    return grey[:, None] * np.array([0.98, 1.0, 1.03])
