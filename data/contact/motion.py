"""Motion of the tissue at the contact: between two frames, and from the onset of contact through its release.

A contact point that is detected anew in every frame slides over the tissue with the tool. A track of the same tissue
point instead (dense optical flow, then its depth) observes deformation.
"""

import contextlib
import dataclasses
import math
from collections import deque

import numpy as np

from palpate.data.contact.geometry import LEAST_NOISE, TISSUE, GeometryStatus, dent_geometry, frame_geometry
from palpate.data.contact.outlines import inside, uncover
from palpate.data.contact.refinement import REFINE_FRAMES, ContactRun, picture_pixel, settle_run
from palpate.data.contact.rest_depth import RestDepth
from palpate.data.contact.surface import smooth_surface
from palpate.data.contact.tissue_points import grid_to_picture, lift, picture_to_grid, reference_pixels, rigid_motion
from palpate.data.prepared import PreparedFrame
from palpate.data.settings import PrepareSettings
from palpate.data.source.camera import Camera
from palpate.data.tracks.tissue import TissueTemplate, TissueTracker

LOST = "The tissue that was touched first is not followed here or has no depth; nothing of its motion is observed."
DENTED = "Contact begins while tissue is or may be dented from an earlier one, so its shape at rest isn't known."
REST_FRAMES = 3
"""Number of frames before a contact in which tracked tissue must have returned to rest."""


class ContactMotion:
    """Links each frame of a clip with the next: observed displacement, contact and its tracked point."""

    def __init__(
        self, camera: Camera, size: tuple[int, int], settings: PrepareSettings, *, from_shading: bool = False
    ) -> None:
        """
        Args:
            camera: intrinsics of the grid.
            size: (width, height) of the full picture [px].
            settings: geometry, `bridge_frames` and `track_seconds` count.
            from_shading: True = depth is the shape by shading.
        """
        # Surfaces from shading are smooth, and change from one picture to the next (docs/reports/video.md).
        self._least_noise = 0.02 if from_shading else LEAST_NOISE
        self.camera, self.size, self.settings = camera, size, settings.geometry
        self.bridge_frames, self.track_seconds = settings.bridge_frames, settings.track_seconds
        self._tracker = TissueTracker()
        self._rest = RestDepth()
        self._smooth = -1, np.empty(0)
        """Index and smoothed depth of the frame smoothed last."""
        self._run: ContactRun | None = None
        self._last_contact: int | None = None
        self._last_time = -math.inf
        self._left: deque[float] = deque(maxlen=REST_FRAMES)
        self._refused = False
        """True if the contact under way began on tissue that was not at rest."""

    def link(self, before: PreparedFrame, after: PreparedFrame) -> None:
        """Fill in the motion of `before`, and the run, tracked point and backward motion of `after`."""
        before.consecutive = after.follows(before.frame.number)
        if not (before.consecutive and before.visible and after.visible):
            # Contact that is already there when the view returns has no known onset.
            self.settle()
            self._rest = RestDepth()
            self._run, self._last_contact = None, after.frame.index if after.in_contact else None
            self._refused = False
            if before.in_contact:
                self._last_time = before.frame.time_s
            return
        if before.in_contact:
            self._last_contact, self._last_time = before.frame.index, before.frame.time_s
        self._rest.push(before)
        if self._run is not None or before.in_contact or after.in_contact:
            self._observe(before, after)
        self._update_run(before, after)
        if self._run is None and self._refused and after.in_contact:
            after.detail = after.detail or DENTED
        run = self._run
        if run is not None:
            after.track_start = run.onset.frame.index
            after.track_position = self._lift(run.pixel[None], after)[0] - run.drift
            self._grow_older(run, after)
            self._note_return(run, after)
            if after.in_contact and not after.detail and not np.isfinite(after.track_position).all():
                after.detail = LOST

    @property
    def settled(self) -> bool:
        """True if nothing more will change about the frames linked so far."""
        return self._run is None or self._run.young is None

    def settle(self) -> None:
        """Fix the place of a young contact, after which nothing about the frames linked so far changes."""
        if self._run is not None:
            settle_run(self._run, self.size, self._lift, self._tracker)

    def _grow_older(self, run: ContactRun, latest: PreparedFrame) -> None:
        if run.young is None or latest is run.onset:
            return
        followed = np.isfinite(run.pixel).all()
        if followed and latest.in_contact:
            run.young.append((latest, run.pixel, run.drift))
        if len(run.young) == REFINE_FRAMES or not followed or not latest.in_contact:
            self.settle()
            latest.track_position = self._lift(run.pixel[None], latest)[0] - run.drift

    def _observe(self, before: PreparedFrame, after: PreparedFrame) -> None:
        before.rigid = self._rigid(before, after)
        shift = before.rigid if self.settings.rigid_motion == "subtract" else np.zeros(3)
        if self.settings.displacement == "tracked":
            before.displacement = self._follow_contact(before, after) - shift
            after.backward = self._follow_contact(after, before) + shift
        elif before.in_contact and after.in_contact:
            moved = after.contact.tissue_point.astype(np.float64) - before.contact.tissue_point
            before.displacement, after.backward = moved - shift, shift - moved
        run = self._run
        if run is not None:
            moved = self._follow(before, after, run.pixel, run.template)
            run.drift = run.drift + shift
            run.pixel = moved if np.isfinite(run.drift).all() else np.full(2, math.nan)

    def _update_run(self, before: PreparedFrame, after: PreparedFrame) -> None:
        """Begin a track at a contact after frames known to be without one; end it some time after its release."""
        index = after.frame.index
        missing = math.inf if self._last_contact is None else index - self._last_contact - 1
        if not after.in_contact:
            expired = self._run is not None and after.frame.time_s - self._run.onset.frame.time_s > self.track_seconds
            if expired and missing >= self.bridge_frames:
                self._run = None
        elif missing > self.bridge_frames:
            self.settle()
            # Darkening is measured against the light at rest, also after earlier contacts.
            self._refused = after.press is None and self._dented(after)
            began = (before.out_of_contact or after.press is not None) and not self._refused
            self._run = self._begin(after) if began else None
            self._left.clear()

    def _note_return(self, run: ContactRun, latest: PreparedFrame) -> None:
        """Record the distance of tracked tissue from rest while nothing touches it."""
        if latest.in_contact:
            self._left.clear()
        elif run.young is None:
            rest = run.onset.contact
            self._left.append(float((latest.track_position - rest.mesh.vertices[rest.vertex]) @ rest.normal))

    def _dented(self, onset: PreparedFrame) -> bool:
        """Return whether the tissue may still be dented from an earlier contact; False without a noise level."""
        if self.settings.smoothing == 0:
            return False
        followed = self._run is not None and self.settings.rigid_motion == "subtract" and len(self._left) == REST_FRAMES
        if followed and np.isfinite(self._left).all():
            # Not over the root of REST_FRAMES: rounding errors and the camera's drift are the same in all of them.
            return abs(float(np.mean(self._left))) > 4.0 * self._run.onset.contact.noise
        # Tissue that isn't followed counts as being at rest again after a second.
        return onset.frame.time_s - self._last_time < 1.0

    def _begin(self, onset: PreparedFrame) -> ContactRun:
        if self.settings.smoothing > 0:
            # The frames before show the same tissue at rest, and the contact without the tool in front of it.
            with contextlib.suppress(GeometryStatus):
                noise = self._noise(onset)
                rest = self._rest.at(onset)
                shown, given = (onset.depth, onset.labels), (self.camera, self.settings, rest)
                if onset.press is not None:
                    resting = dent_geometry(*shown, onset.contact.pixel, *given)
                else:
                    resting = frame_geometry(*shown, *given, onset.ends)
                onset.geometry = dataclasses.replace(resting, noise=noise, surface=None)
        pixel = picture_pixel(onset, self.size)
        template = self._tracker.template(onset.shown, pixel)
        young = [] if math.isfinite(onset.contact.noise) and onset.press is None else None
        return ContactRun(onset, pixel, template, np.zeros(3), young)

    def _noise(self, onset: PreparedFrame) -> float:
        """Standard deviation of the depth [scene units], measured away from the outlines, where masks may be wrong."""
        tissue = inside((onset.labels == TISSUE) & (onset.depth > 0))
        if tissue.sum() < self.settings.min_tissue_pixels:
            return max(onset.contact.noise, self._least_noise)
        return max(smooth_surface(onset.depth, tissue, self.settings.smoothing)[1], self._least_noise)

    def _follow_contact(self, source: PreparedFrame, target: PreparedFrame) -> np.ndarray:
        """Motion of the source's contact point to the target, shape [3]; NaN where it can't be tracked."""
        if not source.in_contact:
            return np.full(3, math.nan)
        pixel = picture_pixel(source, self.size)
        moved = self._follow(source, target, pixel, self._tracker.template(source.shown, pixel))
        return (self._lift(moved[None], target) - self._lift(pixel[None], source))[0]

    def _follow(
        self, source: PreparedFrame, target: PreparedFrame, pixel: np.ndarray, template: TissueTemplate
    ) -> np.ndarray:
        """Place of a followed point in the next picture: by flow, corrected by its template; NaN where it is lost."""
        moved = self._tracker.near(source.shown, target.shown, pixel)
        return self._tracker.again(template, target.shown, moved) if np.isfinite(moved).all() else moved

    def _rigid(self, before: PreparedFrame, after: PreparedFrame) -> np.ndarray:
        """Motion that the contact would have if it moved with the tissue far from it, shape [3]; NaN if not known."""
        if before.in_contact or after.in_contact:
            pixel = picture_pixel(before if before.in_contact else after, self.size)
        elif self._run is not None and np.isfinite(self._run.pixel).all():
            pixel = self._run.pixel
        else:
            return np.full(3, math.nan)
        grid = picture_to_grid(pixel, before.depth.shape, self.size)
        place, found = self._lift(pixel[None], before)[0], np.full(3, math.nan)
        for most in (64, 1024):
            pixels = reference_pixels(before.depth, before.labels, grid, most)
            pixels = grid_to_picture(pixels, before.depth.shape, self.size)
            moved = self._tracker.each(before.shown, after.shown, pixels)
            found = rigid_motion(self._lift_smooth(pixels, before), self._lift_smooth(moved, after), place)
            # On smooth tissue few are followed.
            if np.isfinite(found).all():
                break
        return found

    def _lift(self, pixels: np.ndarray, prepared: PreparedFrame) -> np.ndarray:
        """Points [P, 3] of full-picture pixels [P, 2]."""
        grid = picture_to_grid(pixels, prepared.depth.shape, self.size)
        noise = math.nan if self._run is None else self._run.onset.contact.noise
        labels = uncover(prepared.depth, prepared.labels, noise)
        return lift(grid, prepared.depth, labels, self.camera)

    def _lift_smooth(self, pixels: np.ndarray, prepared: PreparedFrame) -> np.ndarray:
        """Points [P, 3] on the smoothed surface: drift adds up from frame to frame, and with it the depth's noise."""
        depth = prepared.depth
        if prepared.geometry is not None and prepared.geometry.surface is not None:
            depth = prepared.geometry.surface
        elif self.settings.smoothing > 0:
            if self._smooth[0] != prepared.frame.index:  # every frame is asked for with the one before and after it
                tissue = (prepared.labels == TISSUE) & (depth > 0)
                self._smooth = prepared.frame.index, smooth_surface(depth, tissue, self.settings.smoothing)[0]
            depth = self._smooth[1]
        grid = picture_to_grid(pixels, prepared.depth.shape, self.size)
        return lift(grid, depth, prepared.labels, self.camera)
