"""Follows tissue points from frame to frame, so that the same piece of tissue is observed and not the tool's motion.

Bini 2026 (section 3.2) compares contact points that are detected anew in each frame; these slide over the tissue with
the tool. Dense inverse search flow (Kroeger 2016, OpenCV's DIS) gives the tissue's own motion; the forward-backward
check is Kalal 2010's.
"""

from __future__ import annotations

import cv2
import numpy as np

from palpate.data.labels import TISSUE, TOOL

RADIUS = 8.0
"""Of the neighbourhood of a point; doubled twice where too few pixels of it can be used [px of the full picture]."""
TOOL_MARGIN = 6.0
"""Distance from the tool within which flow is not trusted [px of the full picture]."""
CONSISTENCY = 1.0
"""Largest distance between a pixel and where flow and backward flow return it to [px of the full picture]."""
LEAST_PIXELS = 12
"""Fewest half-resolution pixels whose median is taken."""


class TissueTracker:
    """Moves tissue points by the median flow of the tissue around them.

    Flow is computed at half resolution. Flow near a moving tool is smeared over the tissue, so pixels within
    TOOL_MARGIN of the tool count only where nothing else is left.
    """

    def __init__(self) -> None:
        self._flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        # The preset's coarser finest scale flattens a local bump of 4 px by 0.7 px, this one by 0.2 px; the variational
        # refinement changes nothing there and doubles the time.
        self._flow.setFinestScale(0)
        self._flow.setVariationalRefinementIterations(0)
        self._pair: tuple[np.ndarray, np.ndarray] | None = None
        self._flows: tuple[np.ndarray, np.ndarray] | None = None

    def step(
        self,
        previous: np.ndarray,
        following: np.ndarray,
        labels_previous: np.ndarray,
        labels_following: np.ndarray,
        points: np.ndarray,
    ) -> np.ndarray:
        """Follow points from one frame to the next; swap the arguments to follow them backwards in time.

        Args:
            previous: picture that the points lie in, uint8 [H, W, 3] RGB.
            following: picture to follow them to, same shape.
            labels_previous: label map of `previous`, [H, W].
            labels_following: label map of `following`, [H, W].
            points: (u, v) in full-resolution pixels, [P, 2].

        Returns:
            The points' new places [P, 2] float32, NaN where lost.
        """
        points = np.asarray(points, np.float32).reshape(-1, 2)
        moved = np.full_like(points, np.nan)
        forward, backward = self._flow_pair(previous, following)
        scale = np.array(previous.shape[1::-1], np.float32) / np.array(forward.shape[1::-1], np.float32)
        allowed = self._consistent(forward, backward, scale)
        allowed &= _lands_on_tissue(forward, labels_following)
        tissue = _shrink(labels_previous == TISSUE, forward.shape[:2])
        tool = _shrink(labels_previous == TOOL, forward.shape[:2])
        distance = cv2.distanceTransform((~tool).astype(np.uint8), cv2.DIST_L2, 3) if tool.any() else None
        usable = tissue & allowed
        trusted = usable if distance is None else usable & (distance > TOOL_MARGIN / scale.mean())
        for index, point in enumerate(points):
            flow = self._flow_near((point + 0.5) / scale - 0.5, forward, trusted, usable, float(scale.mean()))
            if flow is not None:
                moved[index] = point + flow * scale
        width, height = previous.shape[1], previous.shape[0]
        inside = (moved >= -0.5).all(axis=1) & (moved[:, 0] < width - 0.5) & (moved[:, 1] < height - 0.5)
        moved[~inside] = np.nan
        return moved

    def _flow_pair(self, previous: np.ndarray, following: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forward and backward flow [h, w, 2] at half resolution; the last pair is kept for the swapped call."""
        if self._pair is not None and self._flows is not None:
            if self._pair[0] is previous and self._pair[1] is following:
                return self._flows
            if self._pair[1] is previous and self._pair[0] is following:
                return self._flows[::-1]
        first, second = _half_gray(previous), _half_gray(following)
        self._pair = (previous, following)
        forward = self._flow.calc(first, second, None)  # ty: ignore[no-matching-overload]  no first guess
        self._flows = forward, self._flow.calc(second, first, None)  # ty: ignore[no-matching-overload]  no first guess
        return self._flows

    def _consistent(self, forward: np.ndarray, backward: np.ndarray, scale: np.ndarray) -> np.ndarray:
        """Pixels that flow and backward flow return to where they were, bool [h, w]."""
        columns, rows = _targets(forward)
        returned = cv2.remap(backward, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        height, width = forward.shape[:2]
        inside = (columns >= 0) & (columns <= width - 1) & (rows >= 0) & (rows <= height - 1)
        return inside & (np.linalg.norm((forward + returned) * scale, axis=2) < CONSISTENCY)

    def _flow_near(
        self, point: np.ndarray, flow: np.ndarray, trusted: np.ndarray, usable: np.ndarray, scale: float
    ) -> np.ndarray | None:
        """Median flow [2] of the tissue around a half-resolution point, or None where there is too little tissue."""
        if not np.isfinite(point).all():
            return None
        for mask, factor in ((trusted, 1), (trusted, 2), (trusted, 4), (usable, 4)):
            radius = factor * RADIUS / scale
            low = np.maximum(np.floor(point - radius), 0).astype(int)
            high = np.maximum(np.ceil(point + radius) + 1, 0).astype(int)
            window = np.s_[low[1] : high[1], low[0] : high[0]]
            rows, columns = np.nonzero(mask[window])
            near = np.hypot(columns + low[0] - point[0], rows + low[1] - point[1]) <= radius
            if near.sum() >= LEAST_PIXELS:
                return np.median(flow[window][rows[near], columns[near]], axis=0)
        return None


def _half_gray(image: np.ndarray) -> np.ndarray:
    """Grey picture at half resolution, uint8 [H/2, W/2], from RGB."""
    gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return cv2.resize(gray, (max(gray.shape[1] // 2, 1), max(gray.shape[0] // 2, 1)), interpolation=cv2.INTER_AREA)


def _targets(flow: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Columns and rows that the flow leads each pixel to, float32 [h, w] each."""
    rows, columns = np.indices(flow.shape[:2], np.float32)
    return flow[..., 0] + columns, flow[..., 1] + rows


def _lands_on_tissue(flow: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Pixels that the flow does not lead under the tool, bool [h, w]: such a match would be the tool's own."""
    tool = _shrink(labels == TOOL, flow.shape[:2]).astype(np.uint8)
    return cv2.remap(tool, *_targets(flow), cv2.INTER_NEAREST) == 0


def _shrink(mask: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Nearest-neighbour copy of a mask at another size, bool [h, w]."""
    return cv2.resize(mask.astype(np.uint8), shape[::-1], interpolation=cv2.INTER_NEAREST).astype(bool)
