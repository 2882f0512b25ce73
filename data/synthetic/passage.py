"""The tool of a view that tissue fills: its way in space, the pixels that it covers, and its shadows.

A ball at its tip, a cone and a shaft, in front of the tissue in every frame. The ball touches the tissue along the line
of sight. The tool comes and leaves along its axis or a little aside of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from palpate.data.synthetic.scene import Scene, draw_contact_frames, draw_way

if TYPE_CHECKING:
    from palpate.data.synthetic.truth import TrueMotion

SHAFT_RADIUS = 0.021
"""Radius of the shaft [scene units]."""


@dataclass(frozen=True)
class Passage:
    """Shape of the tool, and its place in every frame."""

    tip: np.ndarray
    """Point of the tool that touches the tissue in contact, shape [F, 3] [scene units]."""
    axis: np.ndarray
    """Unit vector from the tip along the shaft, shape [3]."""
    ball: float
    """Radius of the tip [scene units]."""
    cone: float
    """Distance along the axis from the tip to the shaft [scene units]."""

    def crossed(self, frame: int, origin: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, ...]:
        """Closest approach of rays to the tool's axis.

        Args:
            frame: index of the frame.
            origin: common origin of the rays, shape [3].
            rays: unit vectors, shape [..., 3].

        Returns:
            Distance along the ray, distance from the axis, the tool's radius there, place along the axis [scene units];
            the sine of the angle between ray and surface line; shape [...] each.
        """
        tip = self.tip[frame]
        center = (tip * (1 - self.ball / np.linalg.norm(tip)) - origin).astype(np.float32)
        axis = self.axis.astype(np.float32)
        ahead, turn = rays @ center, rays @ axis
        sine = np.sqrt(np.maximum(1 - turn * turn, 1e-9))
        along = np.maximum((turn * ahead - center @ axis) / np.square(sine), 0)
        reach = ahead + along * turn
        apart = np.sqrt(np.maximum(center @ center + along * (2 * center @ axis + along) - reach * reach, 0))
        radius = np.minimum(self.ball + (SHAFT_RADIUS - self.ball) * along / self.cone, SHAFT_RADIUS)
        return reach, apart, radius, along, np.where(along > 0, sine, 1.0)

    def lit(self, frame: int, lamp: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Share of a lamp's disc at a place [3] that points see past the tool, both of shape [H, W, …]."""
        far = np.linalg.norm(points - lamp, axis=-1)
        reach, apart, radius, *_ = self.crossed(frame, lamp, (points - lamp) / far[..., None])
        blur = 2 * 0.006 * np.maximum(1 - reach / far, 1e-6)  # by the lamp's radius [scene units]
        return np.where((reach > 0) & (reach < far), np.clip(0.5 + (apart - radius) / blur, 0, 1), 1.0)


def draw_passage(scene: Scene, motion: TrueMotion, generator: np.random.Generator) -> Passage:
    """Draw the tool and its way: it comes, touches tissue or stops in front of it, and leaves, or it passes by.

    Raises:
        SceneError: the clip is too short, or the tool has no room.
    """
    settings, frames, vertices = scene.settings, np.arange(scene.settings.frames), scene.mesh.vertices
    towards = -vertices[scene.vertex] / np.linalg.norm(vertices[scene.vertex])
    side = np.append(scene.entry, 0.0)
    side -= side @ towards * towards
    elevation = math.radians(generator.uniform(*settings.elevation_deg))
    axis = math.cos(elevation) * side / np.linalg.norm(side) + math.sin(elevation) * towards
    back = axis + generator.uniform(-0.3, 0.3) * np.cross(side, towards)
    begin, end, radius = motion.onset_frame, motion.release_frame, motion.patch_radius
    # Without contact, no deeper than tissue at rest, nor than tissue that swings out of its dent.
    risen = np.maximum(motion.contact @ towards, 0)[:, None] * towards
    tip = vertices[motion.touched] + np.where(motion.in_contact[:, None], motion.contact, risen)
    if not motion.in_contact.any():
        begin, end = draw_contact_frames(settings, generator)
        radius = generator.uniform(*settings.patch_radius)
        if settings.action == "pass":
            begin, end = 0, settings.frames
            far = np.append(draw_way(scene, "travel", 1.0, generator) * scene.spacing, 0.0)
            far -= far @ scene.direction * scene.direction
            tip = tip + np.linspace(-1, 1, settings.frames)[:, None] * far
        lift = math.exp(generator.uniform(*np.log(settings.hover_height)))
        height = scene.sheet.depth(*(tip[:, :2] / tip[:, 2:]).T) - tip[:, 2]
        tip = tip + (lift - height.min()) * towards
    # Scene units a frame, share of a frame before contact, share of the way to the picture's border.
    speed, share, reach = generator.uniform((0.008, 0.0, 0.3), (0.03, 0.6, 0.7))
    size, contact = np.array(scene.mesh.grid_shape[::-1]), scene.mesh.pixels[scene.vertex, ::-1]
    room = np.min(np.where(scene.entry > 0, size - 1 - contact, contact) / np.abs(scene.entry)) * scene.spacing
    away = np.maximum(np.maximum(begin - frames, frames - end + 1) - share, 0)
    # The tip goes no farther than 0.12 scene units from where it touches.
    tip = tip + np.minimum(speed * away, min(reach * room, 0.12))[:, None] * back
    ball, cone = scene.spacing * np.array((max(0.7, 0.8 * radius), generator.uniform(25, 45)))
    return Passage(tip, axis, ball, cone)
