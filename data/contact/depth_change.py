"""How much deeper tissue lies in a frame than in an earlier one, while the picture may move.

What a moving camera or a changing scale adds to the depth is smooth over the picture, and so is a depth network's
bias: both are subtracted. The noise is the change's spread over the picture, and at least what one frame's depth varies
by from pixel to pixel: rounded depth hardly changes while tissue is still, and then in steps.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from palpate.common.robust import median_sd, trimmed_fit
from palpate.data.contact.geometry import LEAST_NOISE
from palpate.data.contact.outlines import inside, near
from palpate.data.gaussian import gaussian_sum
from palpate.data.labels import TISSUE, TOOL
from palpate.data.prepared import PreparedFrame
from palpate.data.shading.registration import scaled
from palpate.data.tracks.background import Background
from palpate.data.tracks.following import Shown

SCALES = (0.0, 1.0, 2.0)
"""Changes are looked at over these widths: standard deviations of a blur [grid px]."""
WIDE = 12.0
"""What changes over this width around, too, is no dent but the camera or the depth's bias [grid px]."""
ITERATIONS, OUTLIER = 3, 3.0
"""Rounds of the fit of what the camera changes, and standard deviations beyond which a pixel doesn't belong to it."""


@dataclass(frozen=True, eq=False)
class DepthChange:
    """How much deeper than at rest, and than around it, tissue lies in a frame; S scales."""

    contrast: np.ndarray
    """Shape [S, h, w] [scene units]; not a number where no tissue is known."""
    noise: np.ndarray
    """Its standard deviation, shape [S] [scene units]."""

    def sigmas(self) -> np.ndarray:
        """The largest contrast over the scales in standard deviations, shape [h, w]; -inf where nothing is known."""
        ratio = self.contrast / self.noise[:, None, None]
        return np.where(np.isfinite(ratio), ratio, -np.inf).max(axis=0)


def change_since(before: PreparedFrame, after: PreparedFrame, motion: np.ndarray) -> DepthChange | None:
    """Compare a frame with an earlier one; None where too few pixels are known.

    Args:
        before, after: the frames.
        motion: of the picture on the grid between them, shape [3, 3].
    """
    size = after.depth.shape[::-1]
    rest, visible = (
        cv2.warpAffine(part, motion[:2], size) for part in (before.depth, _tissue(before).astype(np.float32))
    )
    # A larger change of depth is the sensor's error.
    known = inside(_tissue(after) & (visible > 0.999)) & (np.abs(after.depth - rest) < 0.1)
    return depth_change(after.depth, rest, known) if known.sum() >= 200 else None


def _tissue(prepared: PreparedFrame) -> np.ndarray:
    return (prepared.labels == TISSUE) & (prepared.depth > 0) & ~near(prepared.labels == TOOL)


def depth_change(depth: np.ndarray, rest: np.ndarray, known: np.ndarray) -> DepthChange:
    """Compare depth [h, w] with that at rest [h, w] where both are known, [h, w] bool [scene units]."""
    change = np.where(known, depth - rest, 0.0)
    # Smooth: its own noise, and an older dent, are no parts of what a scale changes.
    smooth = _blurred(rest, known, WIDE)
    depths, places = smooth[known][:, None], np.argwhere(known) / WIDE
    # What a moving camera or a changing scale adds.
    terms = np.hstack([np.ones_like(depths), depths, depths * places])
    change[known] -= trimmed_fit(terms, change[known], ITERATIONS, OUTLIER)
    around = _blurred(change, known, WIDE)
    contrast, noise = [], []
    for scale in SCALES:
        deeper = _blurred(change, known, scale)
        # Next to a bump tissue hasn't sunk.
        contrast.append(deeper - np.maximum(around, 0))
        # A frame's own noise at a scale is what differs from a blur so much wider.
        rough = _blurred(depth, known, scale) - _blurred(depth, known, scale + 2.0)
        rough -= _blurred(np.nan_to_num(rough), known & np.isfinite(rough), WIDE)
        noise.append(max(median_sd(deeper - around), median_sd(rough), LEAST_NOISE / (1 + 4 * scale)))
    return DepthChange(np.stack(contrast), np.array(noise))


def _blurred(values: np.ndarray, known: np.ndarray, scale: float) -> np.ndarray:
    """Gaussian mean over the known pixels, shape [h, w]; not a number where they are too few."""
    if scale == 0:
        return np.where(known, values, np.nan)
    weight, total = (gaussian_sum(part.astype(np.float32), scale) for part in (known, np.where(known, values, 0)))
    # Least share of a blur's weight that must lie on tissue.
    least = 0.5 if scale < WIDE else 0.0
    return np.where(known & (weight > least), total / np.maximum(weight, 1e-6), np.nan)


def grid_motion(background: Background | None, shown: Shown, prepared: PreparedFrame) -> np.ndarray:
    """Motion of a frame's picture on its grid, (u, v, 1) to (u, v, 1), shape [3, 3]; none where it isn't known.

    Args:
        background: the same in the picture that is followed.
        shown: that picture.
        prepared: the frame.
    """
    if background is None:
        return np.eye(3)
    motion = np.eye(3) + np.vstack([background.affine.T, np.zeros(3)])
    return scaled(motion, np.divide(prepared.depth.shape, shown.gray.shape)[::-1])
