"""Depth from brightness, without training: an endoscope's light is next to its lens, so that nearer tissue is brighter.

A matt surface of albedo ρ at the distance R along its ray sends back I ∝ ρ·cosθ/R². θ is the angle between its normal
and the ray, α that between ray and optical axis, and R = z/cosα. For a surface parallel to the image plane (θ = α),
z = cos^1.5(α)·sqrt(ρ/I): relative depth for one albedo and one exposure.
"""

import math
from functools import lru_cache

import cv2
import numpy as np

from palpate.data.depth.model import RawDepth
from palpate.data.depth.sources import DepthSource, check_map
from palpate.data.picture_network import resized
from palpate.data.source.frames import Frame

DARKEST = 0.005
"""Least linear brightness (white = 1) of a valid pixel, 15 of 255 in sRGB; sensor noise dominates in darker ones."""


def photometric_depth(picture: np.ndarray) -> np.ndarray:
    """Relative depth of a picture, shape [h, w] float32; 0 = too dark.

    Nothing is normalised by the frame, so a change of exposure appears as a change of depth.

    Args:
        picture: sRGB in [0, 1], shape [h, w, 3] float32.
    """
    channels = (np.ascontiguousarray(picture[..., index]) for index in (0, 1))
    red, green = (np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4) for part in channels)
    # Blood absorbs green and blue, so red varies least with albedo; green helps where red saturates.
    brightness = 0.7 * red + 0.3 * green
    # Narrow highlights (opening) and narrow dark vessels (closing) are pulled in to within a factor of 1.2.
    square = np.ones((9, 9), np.uint8)
    filtered = cv2.morphologyEx(cv2.morphologyEx(brightness, cv2.MORPH_OPEN, square), cv2.MORPH_CLOSE, square)
    brightness = np.clip(brightness, filtered / 1.2, filtered * 1.2)
    usable = (brightness > DARKEST).astype(np.float32)
    parts = (brightness * usable).astype(np.float32), usable
    total, weight = (cv2.GaussianBlur(part, (37, 37), 6, borderType=cv2.BORDER_CONSTANT) for part in parts)
    smooth = total / np.maximum(weight, 1e-6) * usable
    depth = _falloff(smooth.shape) / np.sqrt(np.maximum(smooth, DARKEST))
    return np.where(smooth > DARKEST, depth, 0).astype(np.float32)


@lru_cache(maxsize=4)
def _falloff(shape: tuple[int, int]) -> np.ndarray:
    """cos^1.5(α) at every pixel of a picture of a shape (H, W)."""
    height, width = shape
    # Horizontal field of view that is assumed [degrees].
    pitch = 2 * math.tan(math.radians(60.0) / 2) / width
    across, down = ((np.arange(side) - (side - 1) / 2) * pitch for side in (width, height))
    return (1 / np.sqrt(down[:, None] ** 2 + across**2 + 1)) ** 1.5


class PhotometricDepth(DepthSource):
    """Depth of a clip from the brightness of its pictures."""

    identity = "photometric"
    from_picture = from_shading = True

    def observe(self, frame: Frame) -> RawDepth:
        """The frame's relative depth, checked."""
        height, width = frame.picture.shape[:2]
        # Longer side of the picture whose brightness is read [px].
        rows, columns = (max(2, 2 * round(side * 428 / max(height, width) / 2)) for side in (height, width))
        picture = resized(frame.picture.astype(np.float32), rows, columns) / np.float32(255)
        found = photometric_depth(picture)
        check_map(found, f"The brightness of frame {frame.number}", signed=False)
        return RawDepth(cv2.resize(found, (width, height), interpolation=cv2.INTER_LINEAR))
