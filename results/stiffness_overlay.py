"""Where gripped tissue is stiffer than its mean, drawn on the video as far as that is known."""

import numpy as np
from scipy.spatial import Delaunay, KDTree

from palpate.estimators.grip.grip_estimate import GripEstimate
from palpate.estimators.grip.stiffness_fit import StiffnessField
from palpate.results.field_overlay import paint

STEP = 16
"""Side of the map's squares [px of the field's picture]."""
NEIGHBOURS = 4
"""Followed points by whose motion a corner of the map moves."""
DARKENED = 0.5
"""What is left of the brightness where the stiffness is not known."""
RANGE = 2.0
"""Colours end at this many times the mean, and at one over it."""
UNKNOWN = "Stiffness map: unknown everywhere; the motion determines too little of it."
KNOWN = f"Red: stiffer than the mean of tissue that moves, by {RANGE:g} times or more; blue: softer; dark: unknown."
LOOSE = "The map is no determined result."


class StiffnessMap:
    """The field of one run of contact, ready to be drawn on any of its frames; C corners, F triangles.

    Args:
        grip: with its points and their motion.
        field: its stiffness.
        start: time stamp of the run's first frame [s].
    """

    def __init__(self, grip: GripEstimate, field: StiffnessField, start: float) -> None:
        height, self._width = field.picture.shape[:2]
        columns, rows = np.arange(0, self._width + STEP, STEP), np.arange(0, height + STEP, STEP)
        self._corners = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2).astype(np.float64)
        faces = Delaunay(self._corners).simplices
        known = field.known(self._corners)
        self._faces = faces[known[faces].all(axis=1)]
        """Triangles whose stiffness is known, shape [F, 3]."""
        self._stiffness = np.exp(field.at(self._corners)[0])
        self._times = np.concatenate([[0.0], grip.times]) + start
        self._points, self._moved = grip.points, np.concatenate([np.zeros_like(grip.moved[:1]), grip.moved])
        self.note = UNKNOWN if not len(self._faces) else KNOWN if field.tells else f"{KNOWN} {LOOSE}"
        """What a picture says about it."""

    def shows(self, time: float) -> bool:
        """Whether a time stamp lies within the motion that was fitted [s]."""
        return self._times[0] <= time <= self._times[-1]

    def draw(self, canvas: np.ndarray, time: float, labels: np.ndarray) -> None:
        """Paint what is known on an RGB canvas in place, where the tissue is by then, and darken the rest.

        Nothing is painted where nothing is known, nor on instruments.

        Args:
            canvas: uint8, shape [H, W, 3], of any size.
            time: stamp of the frame [s].
            labels: label map of any resolution.
        """
        if not len(self._faces):
            return
        places = (self._corners + self._displacement(time)) * canvas.shape[1] / self._width
        dark = paint(canvas, places, self._faces, self._stiffness, labels, RANGE)
        canvas[dark] = (DARKENED * canvas[dark]).astype(np.uint8)

    def _displacement(self, time: float) -> np.ndarray:
        """Of the corners in a frame, by the followed points that were nearest at rest, shape [C, 2] [px]."""
        after = int(np.clip(np.searchsorted(self._times, time), 1, len(self._times) - 1))
        share = (time - self._times[after - 1]) / (self._times[after] - self._times[after - 1])
        moved = (1 - share) * self._moved[after - 1] + share * self._moved[after]
        visible = np.isfinite(moved).all(axis=1)
        if not visible.any():
            return np.zeros_like(self._corners)
        apart, nearest = KDTree(self._points[visible]).query(self._corners, k=min(NEIGHBOURS, int(visible.sum())))
        apart, nearest = (item.reshape(len(self._corners), -1) for item in (apart, nearest))
        weights = 1 / np.maximum(apart, 1.0)
        return np.einsum("ck,cki->ci", weights / weights.sum(axis=1, keepdims=True), moved[visible][nearest])


def stiffness_map(grip: GripEstimate | None, start: float) -> StiffnessMap | None:
    """The map of a run that begins at a time stamp [s]; None where no field was fitted, or nothing was followed."""
    if grip is None or grip.stiffness is None or not len(grip.points):
        return None
    return StiffnessMap(grip, grip.stiffness, start)
