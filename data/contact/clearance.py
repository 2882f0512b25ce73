"""Contact by measured depth: how far an instrument's free end is from the tissue under it, along the line of sight.

In a real view instruments are in front of tissue in every frame, so outlines that overlap say nothing. The tissue that
the end hides is a local plane through what is visible around it. An instrument is taken to be as thick as it is wide:
what the camera measures is its near side.
"""

import math

import numpy as np
from scipy.ndimage import distance_transform_edt, minimum_filter, uniform_filter

from palpate.common.robust import median_sd
from palpate.data.contact.evidence import WAITS, ContactEvidence
from palpate.data.contact.geometry import LEAST_NOISE, FrameGeometry, RestTissue
from palpate.data.contact.outlines import near
from palpate.data.contact.rest_depth import RestDepth
from palpate.data.contact.surface import smooth_surface
from palpate.data.labels import OTHER, TISSUE, TOOL
from palpate.data.prepared import PreparedFrame
from palpate.data.source.camera import Camera

MEETS, HOVERS, LEAVES, PRESSES = 2.5, 4.0, 5.0, 8.0
"""Contact begins below the first, and ends above the third, so many standard deviations of the distance. Motion decides
whether it begins between the first two; below the last an instrument touches tissue that has sunk around it."""
SUNK, NEXT_TO, BESIDE = 5.0, 6.0, 15.0
"""Tissue has sunk by so many standard deviations of its depth, as measured far from instruments' ends, beyond the last;
next to them is within the second [cells]."""
AROUND = 30
"""Nothing farther from an instrument's tip is looked at [cells]."""
APART = "The instrument's end is {:.3g} scene units from the tissue by measured depth; contact needs {:.3g} or less."


def end_clearance(prepared: PreparedFrame, camera: Camera) -> tuple[float, float] | None:
    """Distance from instruments' free ends to the tissue under them, and its standard deviation [scene units].

    None where no end with a depth of its own is over tissue, where something else hides an end, or where ends lie
    behind the tissue: their depth is wrong.

    Args:
        prepared: a frame.
        camera: intrinsics of the grid.
    """
    ends, tips = prepared.ends, prepared.ends_within(1.5)
    if ends is None or tips is None or not tips.any():
        return None
    box = tuple(slice(max(place.min() - AROUND, 0), place.max() + AROUND + 1) for place in np.nonzero(tips))
    depth, labels, ends, tips = (each[box] for each in (prepared.depth, prepared.labels, ends, tips))
    tool, tissue = labels == TOOL, (labels == TISSUE) & (depth > 0)
    if not tissue.any():
        return None
    before = near(tips) & (labels == OTHER) & (depth > 0)
    if (before & (depth < depth[tips].max())).any():
        return None
    outline = near(tool)
    # Standard deviation of the weights of the surface by which mislabelled tool pixels are recognised [grid pixels].
    wide, _ = smooth_surface(depth, tissue & ~outline, 6.0, outline)
    noise = max(median_sd((depth - wide)[tissue & ~outline]), LEAST_NOISE)
    # Tissue next to the instrument that lies so many standard deviations in front of that surface is the instrument's.
    tissue &= ~outline | (depth > wide - 5.0 * noise)
    half = distance_transform_edt(tool) - 0.5
    radius = max(0.5, float(half[tool & (distance_transform_edt(~tips) <= half + 1)].max()))
    under = smooth_surface(depth, tissue, max(radius, 1.5), tool)[0]
    measured = ends & (depth > 0)
    # A mask that is too wide shows tissue behind the instrument.
    nearest = minimum_filter(np.where(measured, depth, np.inf), 5)
    # Pixels of an instrument at the tissue's surface are its own up to so far behind others two pixels away [cells].
    behind = (depth > nearest * (1 + 6.0 / camera.fx)) & (np.abs(depth - wide) < 2 * np.hypot(depth / camera.fx, noise))
    valid = (measured & ~behind).astype(np.float64)
    mean = uniform_filter(valid * depth, 3) / np.maximum(uniform_filter(valid, 3), 1e-9)
    judged = (valid > 0) & (under > 0)
    gap = (under - mean)[judged]
    if not judged.any() or 2 * measured.sum() < ends.sum() or np.median(gap) < 0:
        return None
    cell = under[judged] / camera.fx
    distance = gap - 2 * np.minimum(half[judged], radius) * cell
    least = int(np.argmin(distance))
    # Standard deviation of the distance by the grid alone: an outline is known to half a pixel on either side [cells].
    return float(distance[least]), math.hypot(0.7 * cell[least], noise)


def has_sunk(prepared: PreparedFrame, rest: RestTissue) -> bool:
    """Return whether tissue next to instruments' free ends lies deeper than at rest: they press it, or just did.

    Args:
        prepared: a frame with ends.
        rest: depth at rest in its view.
    """
    ends, labels = prepared.ends_within(1.5), prepared.labels
    assert ends is not None
    known = (labels == TISSUE) & (prepared.depth > 0) & rest.known & ~near(labels == TOOL)
    change = np.where(known, prepared.depth - rest.depth, 0.0)
    away = distance_transform_edt(~ends)
    far = known & (away > BESIDE)
    if not far.any():
        return False
    # Depth that is exact is still known to some 1e-4 only: it is rounded and interpolated.
    noise = max(median_sd(change[far]), 1e-4)
    # The mean of nine cells, of which five are known.
    count = uniform_filter(known.astype(np.float64), 3)
    mean = uniform_filter(change, 3) / np.maximum(count, 1e-9)
    return bool((mean[(away < NEXT_TO) & (count > 0.5)] > SUNK * noise).any())


class MeasuredContacts(ContactEvidence):
    """Contact of a clip whose depth is measured; evidence decides where instruments have no usable depth.

    Args:
        near: as in `ContactEvidence`.
        camera: intrinsics of the grid.
    """

    def __init__(self, near: float, camera: Camera) -> None:
        super().__init__(near)
        self._camera = camera
        self._touched: float | None = None
        """Distance in the frame before, if the instrument touched there; it leaves its dent where that grows."""
        self._rest = RestDepth()
        self._standing: list[tuple[PreparedFrame, FrameGeometry | None]] = []
        """The last frames in a row whose instrument may press tissue nearby, and the contacts that outlines show."""

    def judge(self, prepared: PreparedFrame) -> None:
        """Decide a frame by distance where instrument and tissue have a depth, and those before it in which the
        instrument stood there already when the dent was too shallow to be seen.
        """
        outlined, decidable = prepared.geometry, prepared.status in ("ok", "no_contact")
        super().judge(prepared)
        found = end_clearance(prepared, self._camera) if decidable else None
        near, self._standing = self._standing, []
        touched, self._touched = self._touched, None
        if found is None:
            return
        distance, sd = found
        deepens = MEETS * sd < distance <= min(PRESSES * sd, math.inf if touched is None else touched + sd)
        presses = deepens and has_sunk(prepared, self._rest.at(prepared))
        sure = touched is not None or presses or distance <= MEETS * sd
        limit = (PRESSES if presses else HOVERS if touched is None else LEAVES) * sd
        if distance > limit:
            prepared.reject(APART.format(distance, limit))
        elif outlined is not None and sure:
            prepared.accept(outlined)
        self._touched = distance if prepared.in_contact else None
        if prepared.in_contact and not sure:
            return  # by evidence
        prepared.distance = distance
        prepared.contact_probability, prepared.undecided, self._hovering = math.nan, False, None
        while presses and near and near[-1][0].distance <= distance:
            earlier, geometry = near.pop()
            earlier.accept(geometry)
        if distance > PRESSES * sd:
            self._rest.push(prepared)
        elif self._touched is None:
            self._standing = [*near, (prepared, outlined)][-WAITS:]

    def waits(self, prepared: PreparedFrame) -> bool:
        """See `ContactEvidence`."""
        return bool(self._standing) or super().waits(prepared)
