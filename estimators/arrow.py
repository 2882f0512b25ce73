"""Where the estimated force is drawn in a frame."""

from __future__ import annotations

import numpy as np

from data.contact.geometry import FrameGeometry
from estimators.contract import ClipInfo
from physics.mechanics import Bounds

FULL_ARROW = 0.3
"""Length of the drawn arrow of the largest admissible force, as a share of the contact point's depth."""


def force_arrow(
    theta: np.ndarray, contact: FrameGeometry, clip: ClipInfo, bounds: Bounds, direction: np.ndarray
) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """The force as it acts: tail and tip (u, v) [px] of an arrow that ends at the contact, as long as |F| is large."""
    largest, camera = max(abs(value) for value in bounds.force), clip.camera
    tip = contact.tissue_point.astype(np.float64)
    tail = tip - direction * (FULL_ARROW * tip[2] * float(theta[2]) / largest)
    if theta[2] == 0 or tail[2] <= 0:
        return None
    ends = [
        (float(camera.fx * x / z + camera.cx), float(camera.fy * y / z + camera.cy)) for x, y, z in (tail, tip)
    ]  # the inverse of Bini 2026, equation 3
    return ends[0], ends[1]
