"""Tissue of a sequence beside a robot: clouds and followed points under a gripper whose poses are known, in metres.

The tissue is viewed along its own mean normal from far away, and results are turned back. So the simulation doesn't
depend on the sequence's frame.
"""

import dataclasses
from collections.abc import Iterator

import numpy as np

from palpate.data.source.camera import Camera
from palpate.data.source.images import printable
from palpate.data.source.layout import InputError
from palpate.data.source.sequence import Sequence, moved
from palpate.data.tracks.background import FAR
from palpate.estimators.cloud_shape import CloudShape, view_across
from palpate.estimators.online.driven import Cloud, DrivenTissue
from palpate.estimators.online.particle_field import ParticleField, StiffnessMap
from palpate.estimators.online.settings import OnlineSettings
from palpate.estimators.online.surface import Surface, body_below, layers_below

PIXELS = 12.0
"""Distance between particles [px]; followed points of a video at 600 particles have about as many."""


class SequenceTissue:
    """A sheet or a volume of particles under a sequence's gripper.

    Args:
        sequence: that fits together.
        settings: how.

    Raises:
        InputError: a file can't be used, nothing lies in the boxes of pins, or no tissue can be made of the cloud.
    """

    def __init__(self, sequence: Sequence, settings: OnlineSettings) -> None:
        self._sequence, (self._begin, cloud) = sequence, sequence.first
        self.unseen = self._begin - sequence.gripped[0]
        """Frames so far without tissue in their clouds, in which the tool holds it."""
        self._tip = sequence.tool.tips(sequence.times[[self._begin]])[0]
        self._view = view_across(cloud, sequence.eye(self._begin)[:3, 3], self._tip)
        self.surface = self._meshed(moved(cloud, self._view), settings)
        self._points = None if sequence.points is None else moved(sequence.points, self._view)
        rest = np.empty((0, 3)) if self._points is None else self._points[self._begin]
        self._followed = np.flatnonzero(np.isfinite(rest).all(axis=1))
        pixels = np.pad(self.surface.project(rest[self._followed]), ((0, 0), (0, 1)))
        self.driven = DrivenTissue(self.surface, pixels, np.full(len(pixels), np.inf), settings, led=True)

    def fields(self) -> Iterator[tuple[int, ParticleField]]:
        """Yield every frame after the one in which the gripper takes hold, by its index, with the field by then [m]."""
        for frame in self._sequence.held[1:]:
            cloud = moved(self._sequence.cloud(frame), self._view)
            self.unseen += not len(cloud)
            some = np.linspace(0, len(cloud) - 1, min(len(cloud), self.driven.settings.points)).round().astype(int)
            shown: Cloud = cloud[some], self.surface.seen
            yield frame, self._field(self.driven.step(self._moved(frame), shown, self._led(frame)).gap)

    def _moved(self, frame: int) -> np.ndarray:
        """Return the motion of the followed points since rest, in the view's picture and away from its eye, shape [P,
        3] [px]."""
        if self._points is None:
            return np.empty((0, 3))
        rest, now = self._points[self._begin, self._followed], self._points[frame, self._followed]
        away = (now[:, 2] - rest[:, 2]) * (self.surface.camera.fx / rest[:, 2])
        return np.column_stack([self.surface.project(now) - self.surface.project(rest), away])

    def _led(self, frame: int) -> np.ndarray:
        """Return the places to which the tool takes what it holds, turned as it is, shape [G, 3] [m]."""
        first, then = self._sequence.tool.at(self._sequence.times[[self._begin, frame]])
        motion = self._view @ then @ np.linalg.inv(self._view @ first)
        return moved(self.surface.body.rest[self.surface.gripped], motion)

    def _field(self, gap: float | None) -> ParticleField:
        """Return the field as it is now, in the sequence's frame."""
        surface, session, back = self.surface, self.driven.session, np.linalg.inv(self._view)
        tissue = moved(surface.body.rest, back), surface.faces, surface.body.tetrahedra, moved(session.positions, back)
        maps = map(StiffnessMap, session.fields[:2], *self.driven.determined())
        pixels = surface.project(session.positions)
        return ParticleField(self._begin, *tissue, pixels, *maps, self.driven.alone.skill, gap)

    def _meshed(self, cloud: np.ndarray, settings: OnlineSettings) -> Surface:
        """Return particles on a cloud in the view's frame."""
        sequence = self._sequence
        shape = CloudShape(cloud, printable(sequence.files[self._begin]))
        layers = 1 if settings.thickness is None else layers_below(shape.area, settings.thickness, settings.particles)
        wide = np.sqrt(shape.area * layers / settings.particles)
        mesh = shape.mesh(wide)
        places = moved(mesh.vertices.astype(np.float64), np.linalg.inv(self._view))
        from_tip = np.linalg.norm(places - self._tip, axis=1)
        driven = from_tip <= max(sequence.grip_radius, from_tip.min())
        pinned = mesh.rim & (from_tip > np.percentile(from_tip, FAR))
        if len(sequence.pins):
            boxes = sequence.pins[:, :, None]
            pinned = ((boxes[:, 0] <= places) & (places <= boxes[:, 1])).all(axis=2).any(axis=0)
        pinned &= ~driven
        if not pinned.any() or (pinned | driven).all():
            text = "holds no free tissue in its pins' boxes, or all; change them, in the poses' frame and `unit`"
            raise InputError(f"{printable(sequence.path)} {text}.")
        body = body_below(mesh, pinned, settings.thickness, layers)
        focal = PIXELS * float(cloud[:, 2].mean() / wide)
        camera = Camera.from_focal(focal, *(int(PIXELS * count) for count in mesh.grid_shape[::-1]))
        surface = Surface(body, mesh.triangles, np.flatnonzero(driven), np.empty((0, 2)), camera, 0.0)
        return dataclasses.replace(surface, pixels=surface.project(body.rest))
