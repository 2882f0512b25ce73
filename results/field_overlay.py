"""A field of stiffness drawn on the video: red stiff, blue soft, nothing where it isn't known."""

import cv2
import numpy as np

from palpate.data.labels import TOOL
from palpate.estimators.online.particle_field import ParticleField

OPACITY = 0.55
RANGE = 4.0
"""Colours end at this many times the median, and at one over it."""
INSET = 0.3
"""Width of the picture of shapes, as a share of the canvas'."""
STIFF, MIDDLE, SOFT = (np.array(color, float) for color in ((214, 40, 40), (245, 240, 235), (37, 99, 235)))


def draw_field(canvas: np.ndarray, field: ParticleField, factor: float, labels: np.ndarray | None = None) -> None:
    """Paint stiffness against stretch on an RGB canvas in place, and that of shapes on a small copy at its right.

    Each over its median where it is known, on a logarithmic scale from 1/RANGE to RANGE; nothing where neither is.

    Args:
        canvas: uint8, shape [H, W, 3].
        factor: pixels of the canvas a pixel of the source frame.
        labels: label map of any resolution: what an instrument hides isn't painted; None = all is.
    """
    if field.verdict == "undetermined":
        return
    height, width = canvas.shape[:2]
    inset = cv2.resize(canvas, (round(INSET * width), round(INSET * height)), interpolation=cv2.INTER_AREA)
    places = (field.pixels + 0.5) * factor
    against = (canvas, 1.0, field.distance, field.known), (inset, INSET, field.shape, field.shape_known)
    for picture, share, values, known in against:
        if not known.any():
            continue
        faces = field.faces[known[field.faces].all(axis=1)]
        paint(picture, share * places, faces, values / float(np.median(values[known])), labels)
    margin = max(6, round(0.02 * width))
    rows, columns = slice(margin, margin + inset.shape[0]), slice(width - margin - inset.shape[1], width - margin)
    canvas[rows, columns] = inset
    cv2.rectangle(canvas, (columns.start, rows.start), (columns.stop, rows.stop), (203, 213, 225), 1)


def paint(
    canvas: np.ndarray, places: np.ndarray, faces: np.ndarray, values: np.ndarray, labels: np.ndarray | None
) -> None:
    """Paint triangles on an RGB canvas in place, but for what an instrument hides.

    Args:
        canvas: uint8, shape [H, W, 3].
        places, faces: corners [N, 2] [px] and their triangles [F, 3].
        values: of the corners [N]; 1 is neither red nor blue.
        labels: label map of any resolution; None = nothing is hidden.
    """
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
    """RGB of relative stiffness from -1 (soft, blue) to 1 (stiff, red), beyond that as at the ends, shape [F, 3]."""
    share = np.clip(logs, -1, 1)[:, None]
    return np.where(share > 0, MIDDLE + share * (STIFF - MIDDLE), MIDDLE - share * (SOFT - MIDDLE))
