"""How the tissue at the contact moves: between two frames, and from the onset of contact through its release.

A contact point that is detected anew in every frame slides over the tissue with the tool. Following the same tissue
point instead (dense optical flow, then its depth) observes deformation.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from data.camera import Camera
from data.geometry import TISSUE, GeometrySettings, GeometryStatus, frame_geometry, move_contact
from data.prepared import PreparedFrame
from data.rest_depth import RestDepth
from data.smooth_surface import smooth_surface
from data.template import TissueTemplate
from data.tracking import TissueTracker

REFINE_REACH = 3
"""The tissue that yields most is looked for this far from where the contact was detected [grid pixels]."""
REFINE_SIGMA = 3.5
"""Its mean change must exceed this many standard deviations."""
REFINE_FRAMES = 5
"""Frames after the onset that decide where the contact is."""
LIFT_REACH = 8
"""Farthest tissue that gives a covered point its depth [grid pixels]."""
PLANE_POINTS = 6
"""A plane is fitted to at least this many depths."""
REFERENCE_POINTS = 64
"""Largest number of tissue points that show the common (camera) motion."""
REFERENCE_DISTANCE = 25
"""Reference points are at least this far from the contact [grid pixels]."""
REFERENCE_MINIMUM = 6
"""Fewer reference points show no common motion."""


def grid_to_picture(pixels: np.ndarray, grid_shape: tuple[int, int], size: tuple[int, int]) -> np.ndarray:
    """Grid pixels (u, v), shape [P, 2], as pixels of the full picture of `size` (width, height)."""
    scale = np.array([size[0] / grid_shape[1], size[1] / grid_shape[0]])
    return (np.asarray(pixels, np.float64) + 0.5) * scale - 0.5


def picture_to_grid(pixels: np.ndarray, grid_shape: tuple[int, int], size: tuple[int, int]) -> np.ndarray:
    """Pixels (u, v) of the full picture, shape [P, 2], on the grid; the inverse of `grid_to_picture`."""
    scale = np.array([size[0] / grid_shape[1], size[1] / grid_shape[0]])
    return (np.asarray(pixels, np.float64) + 0.5) / scale - 0.5


def lift(pixels: np.ndarray, depth: np.ndarray, labels: np.ndarray, camera: Camera, radius: int = 0) -> np.ndarray:
    """Tissue points at sub-pixel places of the grid.

    Args:
        pixels: grid pixels (u, v), shape [P, 2].
        depth: z, shape [h, w] [scene units], 0 = invalid.
        labels: label map, shape [h, w].
        camera: intrinsics of the grid.
        radius: half side of the window whose tissue gives a point its depth, by a plane through it: at the tool's
            outline half of the neighbourhood is missing, and a mean would be biased towards the other half. 0: the
            nearest tissue pixel, the only choice that keeps a dent as narrow as a pixel.

    Returns:
        Shape [P, 3] float64 [scene units]; not a number where no tissue depth is near.
    """
    valid = (labels == TISSUE) & (depth > 0)
    heights = np.array([_depth_near(u, v, depth, valid, radius) for u, v in pixels]).reshape(-1)
    columns, rows = np.asarray(pixels, np.float64).reshape(-1, 2).T
    return np.stack((heights * (columns - camera.cx) / camera.fx, heights * (rows - camera.cy) / camera.fy, heights), 1)


def _depth_near(u: float, v: float, depth: np.ndarray, valid: np.ndarray, radius: int) -> float:
    if not (math.isfinite(u) and math.isfinite(v)):
        return math.nan
    for reach in (radius, LIFT_REACH):
        top, left = max(round(v) - reach, 0), max(round(u) - reach, 0)
        window = np.s_[top : max(round(v) + reach + 1, 0), left : max(round(u) + reach + 1, 0)]
        rows, columns = np.nonzero(valid[window])
        across, down = columns + left - u, rows + top - v
        values = depth[window][rows, columns].astype(np.float64)
        if radius > 0 and len(values) >= PLANE_POINTS:
            plane = np.linalg.lstsq(np.stack((np.ones(len(values)), across, down), 1), values, rcond=1e-6)[0]
            return float(np.clip(plane[0], values.min(), values.max()))
        if len(values) and (radius == 0 or reach == LIFT_REACH):
            return float(values[np.argmin(np.hypot(across, down))])
    return math.nan


def rigid_motion(before: np.ndarray, after: np.ndarray, at: np.ndarray) -> np.ndarray | None:
    """Displacement that a point would have if it moved rigidly with the others.

    Least-squares rotation and translation (Kabsch), fitted again without the points that fit worse than three times
    the median, so that a deforming part does not count as camera motion.

    Args:
        before, after: the same points in two frames, shape [P, 3] [scene units]; rows that are not finite are ignored.
        at: the point, shape [3] [scene units].

    Returns:
        Shape [3] [scene units], or None with fewer than six points.
    """
    finite = np.isfinite(before).all(1) & np.isfinite(after).all(1)
    before, after = before[finite], after[finite]
    rotation, shift = np.eye(3), np.zeros(3)
    for _ in range(3):
        if len(before) < REFERENCE_MINIMUM:
            return None
        rotation, shift = _kabsch(before, after)
        residual = np.linalg.norm(before @ rotation.T + shift - after, axis=1)
        kept = residual <= 3 * np.median(residual) + 1e-12
        before, after = before[kept], after[kept]
    return rotation @ at + shift - at


def _kabsch(before: np.ndarray, after: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    centre, target = before.mean(0), after.mean(0)
    left, _, right = np.linalg.svd((after - target).T @ (before - centre))
    handed = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    rotation = left @ handed @ right
    return rotation, target - rotation @ centre


def reference_pixels(depth: np.ndarray, labels: np.ndarray, contact: Sequence[int]) -> np.ndarray:
    """Evenly spaced tissue pixels (u, v) far from the contact, shape [P, 2], P at most 64."""
    rows, columns = np.nonzero((labels == TISSUE) & (depth > 0))
    far = np.hypot(columns - contact[0], rows - contact[1]) >= REFERENCE_DISTANCE
    pixels = np.stack((columns[far], rows[far]), 1)
    chosen = np.linspace(0, len(pixels) - 1, min(REFERENCE_POINTS, len(pixels))).round().astype(int)
    return pixels[chosen].astype(np.float64)


def pressed_pixel(
    onset: PreparedFrame, later: Sequence[tuple[PreparedFrame, np.ndarray, float]], sigmas: float
) -> tuple[int, int] | None:
    """Grid pixel (u, v) near a contact whose depth changes most from its rest shape, on average over later frames.

    Args:
        onset: first frame in contact, its mesh at rest.
        later: following frames, where each has the contact's tissue, (u, v) [grid pixels], and by how much its depth is
            larger because of the camera [scene units].
        sigmas: the mean change must exceed this many of its standard deviations.
    """
    mesh, (u, v) = onset.geometry.mesh, onset.geometry.pixel
    near = np.flatnonzero((np.abs(mesh.pixels - (v, u)) <= REFINE_REACH).all(axis=1) & ~mesh.rim)
    total, count = np.zeros(len(near)), np.zeros(len(near))
    for prepared, place, away in later:
        rows, columns = (mesh.pixels[near] + np.rint(place[::-1] - (v, u)).astype(int)).T
        height, width = prepared.depth.shape
        inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        rows, columns = rows.clip(0, height - 1), columns.clip(0, width - 1)
        seen = inside & (prepared.labels[rows, columns] == TISSUE) & (prepared.depth[rows, columns] > 0)
        total += np.where(seen, prepared.depth[rows, columns] - away - mesh.vertices[near, 2], 0.0)
        count += seen
    change = np.abs(total) / np.maximum(count, 1)
    if len(near) == 0 or not later:
        return None
    best = int(np.argmax(np.where(2 * count >= len(later), change, 0.0)))
    if change[best] <= sigmas * onset.geometry.noise / math.sqrt(max(count[best], 1)):
        return None
    row, column = mesh.pixels[near[best]]
    return int(column), int(row)


@dataclass
class _Run:
    """A run of contact whose onset was seen, and the tissue point that is followed from it."""

    start: int
    """Index of the first frame in contact."""
    start_time: float
    """Its time [s]."""
    pixel: np.ndarray | None
    """The followed point in the latest frame, (u, v) [full-picture px]; None once it is lost."""
    template: TissueTemplate
    """The tissue around it at the onset."""
    drift: np.ndarray
    """Rigid motion subtracted so far, shape [3] [scene units]."""
    onset: PreparedFrame
    """The first frame in contact."""
    young: list[tuple[PreparedFrame, np.ndarray, np.ndarray]] | None
    """Frames after it with the point's pixel and the drift in each; None once the contact's place is settled."""


class ContactMotion:
    """Links each frame of a clip with the next: observed displacement, run of contact and its tracked point."""

    def __init__(
        self,
        camera: Camera,
        size: tuple[int, int],
        settings: GeometrySettings,
        *,
        bridge_frames: int,
        track_seconds: float,
    ) -> None:
        """
        Args:
            camera: intrinsics of the grid.
            size: (width, height) of the full picture [px].
            bridge_frames: contact that is missing on up to this many frames is still the same run.
            track_seconds: how long a released contact is followed, from its onset [s].
        """
        self.camera, self.size, self.settings = camera, size, settings
        self.bridge_frames, self.track_seconds = bridge_frames, track_seconds
        self._tracker = TissueTracker()
        self._rest = RestDepth()
        self._smooth: tuple[int, np.ndarray | None] = (-1, None)
        self._run: _Run | None = None
        self._last_contact: int | None = None

    def link(self, before: PreparedFrame, after: PreparedFrame) -> None:
        """Fill in the motion of `before`, and the run, tracked point and backward motion of `after`."""
        before.consecutive = after.frame.number - before.frame.number == 1
        if not (before.consecutive and before.visible and after.visible):
            # Contact that is already there when the view returns has no known onset.
            self.settle()
            self._rest = RestDepth()
            self._run, self._last_contact = None, after.frame.index if after.in_contact else None
            return
        if before.in_contact:
            self._last_contact = before.frame.index
        self._rest.push(before)
        if self._run is not None or before.in_contact or after.in_contact:
            self._observe(before, after)
        self._update_run(before, after)
        if self._run is not None:
            after.track_start = self._run.start
            if self._run.pixel is not None:
                after.track_position = self._lift(self._run.pixel[None], after)[0] - self._run.drift
            self._grow_older(after)

    @property
    def settled(self) -> bool:
        """Whether nothing more will change about the frames linked so far."""
        return self._run is None or self._run.young is None

    def settle(self) -> None:
        """Move a young run's contact to the nearby tissue that has yielded most, and follow that instead.

        Depth noise shifts the closest pair of points by a pixel or two, and a point load makes a dent hardly wider.
        """
        if self.settled:
            return
        run, young = self._run, self._run.young
        run.young = None
        shape, contact = run.onset.depth.shape, self._picture_pixel(run.onset)
        places = [
            (prepared, picture_to_grid(pixel, shape, self.size), float(drift[2])) for prepared, pixel, drift in young
        ]
        yielded = pressed_pixel(run.onset, places, REFINE_SIGMA)
        if yielded is None or yielded == run.onset.geometry.pixel:
            return
        run.onset.geometry = move_contact(run.onset.geometry, yielded)
        moved = self._picture_pixel(run.onset)
        run.onset.track_position = self._lift(moved[None], run.onset)[0]
        for prepared, pixel, drift in young:
            prepared.track_position = self._lift((pixel + moved - contact)[None], prepared)[0] - drift
        if run.pixel is not None:
            run.pixel = run.pixel + moved - contact
        run.template = TissueTemplate(run.onset.frame.image, run.onset.picture_labels, moved)

    def _grow_older(self, latest: PreparedFrame) -> None:
        run = self._run
        if run.young is None or latest is run.onset:
            return
        if run.pixel is not None and latest.in_contact:
            run.young.append((latest, run.pixel, run.drift))
        if len(run.young) == REFINE_FRAMES or run.pixel is None or not latest.in_contact:
            self.settle()
            if run.pixel is not None:
                latest.track_position = self._lift(run.pixel[None], latest)[0] - run.drift

    def _observe(self, before: PreparedFrame, after: PreparedFrame) -> None:
        before.rigid = self._rigid(before, after)
        shift = np.zeros(3)
        if self.settings.rigid_motion == "subtract":
            shift = before.rigid if before.rigid is not None else np.full(3, np.nan)
        if self.settings.displacement == "tracked":
            before.displacement = _finite(self._follow_contact(before, after) - shift)
            after.backward = _finite(self._follow_contact(after, before) + shift)
        elif before.in_contact and after.in_contact:
            moved = after.geometry.tissue_point.astype(np.float64) - before.geometry.tissue_point
            before.displacement, after.backward = _finite(moved - shift), _finite(shift - moved)
        if self._run is not None and self._run.pixel is not None:
            moved = self._follow(before, after, self._run.pixel, self._run.template)
            self._run.drift = self._run.drift + shift
            self._run.pixel = moved if np.isfinite(self._run.drift).all() else None

    def _update_run(self, before: PreparedFrame, after: PreparedFrame) -> None:
        """Begin a run at a contact after frames that were seen without one; end it some time after its release."""
        index = after.frame.index
        missing = math.inf if self._last_contact is None else index - self._last_contact - 1
        if not after.in_contact:
            expired = self._run is not None and after.frame.time_s - self._run.start_time > self.track_seconds
            if expired and missing >= self.bridge_frames:
                self._run = None
        elif missing > self.bridge_frames:
            self.settle()
            known = before.status in ("no_tool", "no_contact")
            self._run = self._begin(after) if known else None

    def _begin(self, onset: PreparedFrame) -> _Run:
        if self.settings.smoothing > 0:
            # The frames before show the same tissue at rest, and the contact without the tool in front of it.
            with contextlib.suppress(GeometryStatus):
                noise = onset.geometry.noise
                rest = self._rest.at(onset)
                resting = frame_geometry(onset.depth, onset.labels, self.camera, self.settings, rest)
                onset.geometry = dataclasses.replace(resting, noise=noise)
        pixel = self._picture_pixel(onset)
        template = TissueTemplate(onset.frame.image, onset.picture_labels, pixel)
        young = [] if math.isfinite(onset.geometry.noise) else None
        return _Run(onset.frame.index, onset.frame.time_s, pixel, template, np.zeros(3), onset, young)

    def _follow_contact(self, source: PreparedFrame, target: PreparedFrame) -> np.ndarray:
        """Motion of the source's contact point to the target, shape [3]; not a number where it can't be followed."""
        if not source.in_contact:
            return np.full(3, np.nan)
        pixel = self._picture_pixel(source)
        template = TissueTemplate(source.frame.image, source.picture_labels, pixel)
        moved = self._follow(source, target, pixel, template)
        if moved is None:
            return np.full(3, np.nan)
        return (self._lift(moved[None], target) - self._lift(pixel[None], source))[0]

    def _follow(
        self, source: PreparedFrame, target: PreparedFrame, pixel: np.ndarray, template: TissueTemplate
    ) -> np.ndarray | None:
        """Place of a followed point in the next picture: by flow, corrected by its template."""
        moved, followed = self._step(source, target, pixel[None])
        if not followed[0]:
            return None
        found = template.locate(target.frame.image, target.picture_labels, moved[0])
        return moved[0] if found is None else found

    def _rigid(self, before: PreparedFrame, after: PreparedFrame) -> np.ndarray | None:
        """Motion that the contact would have if it moved with the tissue far from it, shape [3]."""
        if before.in_contact or after.in_contact:
            pixel = self._picture_pixel(before if before.in_contact else after)
        elif self._run is not None and self._run.pixel is not None:
            pixel = self._run.pixel
        else:
            return None
        grid = picture_to_grid(pixel, before.depth.shape, self.size)
        pixels = grid_to_picture(reference_pixels(before.depth, before.labels, grid), before.depth.shape, self.size)
        if len(pixels) < REFERENCE_MINIMUM:
            return None
        moved, _ = self._step(before, after, pixels)
        place = self._lift(pixel[None], before)[0]
        motion = rigid_motion(self._lift_smooth(pixels, before), self._lift_smooth(moved, after), place)
        return None if motion is None else _finite(motion)

    def _step(self, source: PreparedFrame, target: PreparedFrame, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self._tracker.step(
            source.frame.image, target.frame.image, source.picture_labels, target.picture_labels, pixels
        )

    def _picture_pixel(self, prepared: PreparedFrame) -> np.ndarray:
        """The contact's place in the full picture, (u, v) [px]."""
        return grid_to_picture(np.array(prepared.geometry.pixel), prepared.depth.shape, self.size)

    def _lift(self, pixels: np.ndarray, prepared: PreparedFrame) -> np.ndarray:
        """Points [P, 3] of full-picture pixels [P, 2]."""
        grid = picture_to_grid(pixels, prepared.depth.shape, self.size)
        return lift(grid, prepared.depth, prepared.labels, self.camera, self.settings.depth_radius)

    def _lift_smooth(self, pixels: np.ndarray, prepared: PreparedFrame) -> np.ndarray:
        """Points [P, 3] on the smoothed surface: drift adds up from frame to frame, and with it the depth's noise."""
        if self.settings.smoothing == 0:
            return self._lift(pixels, prepared)
        index, depth = self._smooth
        if index != prepared.frame.index:
            tissue = (prepared.labels == TISSUE) & (prepared.depth > 0)
            depth = smooth_surface(prepared.depth, tissue, self.settings.smoothing)[0]
            self._smooth = prepared.frame.index, depth
        grid = picture_to_grid(pixels, prepared.depth.shape, self.size)
        return lift(grid, depth, prepared.labels, self.camera)


def _finite(vector: np.ndarray) -> np.ndarray | None:
    return vector if np.isfinite(vector).all() else None
