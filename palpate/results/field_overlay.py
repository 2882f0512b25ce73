"""A field of stiffness drawn on the video: red stiff, blue soft, nothing where it isn't known."""

import cv2
import numpy as np

from palpate.data.labels import TOOL
from palpate.estimators.online.particle_field import ParticleField

OPACITY = 0.55
RANGE = 4.0
"""Colours end at this many times the median, and at one over it."""
STIFF, MIDDLE, SOFT = (np.array(color, float) for color in ((214, 40, 40), (245, 240, 235), (37, 99, 235)))


def draw_field(canvas: np.ndarray, field: ParticleField, factor: float, labels: np.ndarray | None = None) -> None:
    """Paint stiffness against stretch over its median where it is known on an RGB canvas in place.

    Colours are on a logarithmic scale from 1/RANGE to RANGE.

    Args:
        canvas: uint8, shape [H, W, 3].
        factor: pixels of the canvas a pixel of the source frame.
        labels: label map of any resolution: what an instrument hides isn't painted; None = all is.
    """
    known, values = field.distance.known, field.distance.value
    if field.verdict == "undetermined" or not known.any():
        return
    faces, places = field.faces[known[field.faces].all(axis=1)], (field.pixels + 0.5) * factor
    values = values / float(np.median(values[known]))
    found, covered = canvas.copy(), np.zeros(canvas.shape[:2], np.uint8)
    logs = np.log(values[faces].mean(axis=1)) / np.log(RANGE)
    for corners, color in zip(np.round(places[faces]).astype(np.int32), colors(logs), strict=True):
        cv2.fillConvexPoly(found, corners, color.tolist())
        cv2.fillConvexPoly(covered, corners, 1)
    shown = np.ones_like(covered)
    if labels is not None:
        shown = cv2.resize((labels != TOOL).astype(np.uint8), covered.shape[::-1], interpolation=cv2.INTER_NEAREST)
    mixed = cv2.addWeighted(found, OPACITY, canvas, 1 - OPACITY, 0)
    canvas[(covered & shown) > 0] = mixed[(covered & shown) > 0]


def colors(logs: np.ndarray) -> np.ndarray:
    """Return RGB colours of relative stiffness from -1 (soft, blue) to 1 (stiff, red), beyond that as at the ends,
    shape [F, 3]."""
    share = np.clip(logs, -1, 1)[:, None]
    return np.where(share > 0, MIDDLE + share * (STIFF - MIDDLE), MIDDLE - share * (SOFT - MIDDLE))
