"""The lit part of a picture: the endoscope's view, without its dark surround."""

import cv2
import numpy as np


def lit_picture(image: np.ndarray) -> np.ndarray:
    """Lit pixels of the endoscope's picture, bool [H, W], from RGB uint8 [H, W, 3].

    They are the largest connected region that is not black: the dark surround and clipped black pixels are left out.
    """
    first, second, third = cv2.split(cv2.blur(image, (5, 5)))
    # Pixels whose brightest channel is below this are unlit or clipped [8-bit value].
    bright = cv2.max(cv2.max(first, second), third) > 18
    count, regions = cv2.connectedComponents(bright.astype(np.uint8))
    if count <= 2:
        return bright
    likely = regions == 1 + int(np.argmax(np.bincount(regions[::9, ::9].ravel(), minlength=2)[1:]))
    if 2 * np.count_nonzero(likely) > np.count_nonzero(bright):  # without a count of all regions, which takes longer
        return likely
    return regions == 1 + int(np.argmax(np.bincount(regions[bright])[1:]))


def picture_field(lit: np.ndarray) -> np.ndarray:
    """Convex hull of the lit pixels, bool [H, W]: the endoscope's whole picture, shadows included."""
    field = np.zeros(lit.shape, np.uint8)
    outlines, _ = cv2.findContours(lit.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    if outlines:
        cv2.fillConvexPoly(field, cv2.convexHull(np.concatenate(outlines)), 1)
    return field.astype(bool)
