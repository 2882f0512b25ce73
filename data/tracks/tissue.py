"""Follows tissue points from frame to frame, so that the same piece of tissue is observed and not the tool's motion.

Bini 2026 (section 3.2) compares contact points that are detected anew in each frame; these slide over the tissue with
the tool. Here a point moves as most of the tissue around it does, which is followed by `data.tracks.linking`.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from palpate.data.labels import TISSUE, TOOL
from palpate.data.tracks.following import EDGED, Shown, values_at
from palpate.data.tracks.linking import Linker

RADII = (8.0, 16.0, 32.0)
"""Of the neighbourhood of a point, the wider ones where too little of the narrower can be followed [px]. Places at the
tool's edge count only where nothing else is left."""
SPACING = 4
"""Distance of the places in it that are followed [px]."""
LEAST_PLACES = 8
"""Fewest places whose median motion is taken."""
_OFFSETS = np.mgrid[-8:9, -8:9].reshape(2, -1).T * float(SPACING)

View = tuple[np.ndarray, np.ndarray]
"""Picture, uint8 [H, W, 3] RGB, and its label map, [H, W]."""


class TissueTracker:
    """Moves tissue points of one clip between its pictures; lengths are pixels of pictures at most WIDEST wide."""

    def __init__(self) -> None:
        self._linker = Linker()
        self._latest: deque[tuple[np.ndarray, Shown]] = deque(maxlen=2)

    def near(self, source: View, target: View, point: np.ndarray) -> np.ndarray:
        """Where the tissue around a point of one picture takes it in another one.

        Args:
            source, target: the pictures with their labels.
            point: (u, v) in full-resolution pixels, [2].

        Returns:
            (u, v), [2] in full-resolution pixels; not a number where too little tissue is followed.
        """
        if not np.isfinite(point).all():
            return np.full(2, np.nan)
        scale = self._scale(source)
        step, known, away = self._followed(source, target, (point + 0.5) / scale - 0.5 + _OFFSETS)
        distance = np.linalg.norm(_OFFSETS, axis=1)
        for apart, radius in ((EDGED, RADII[0]), (EDGED, RADII[1]), (EDGED, RADII[2]), (0, RADII[2])):
            used = known & (away > apart) & (distance <= radius)
            if used.sum() >= LEAST_PLACES:
                return _within(target[1], point + np.median(step[used], axis=0) * scale)
        return np.full(2, np.nan)

    def each(self, source: View, target: View, points: np.ndarray) -> np.ndarray:
        """Where points [P, 2] of one picture are in another one, each for itself; as of `near`, shape [P, 2]."""
        scale = self._scale(source)
        step, known, _ = self._followed(source, target, (points + 0.5) / scale - 0.5)
        return np.where(known[:, None], _within(target[1], points + step * scale), np.nan)

    def _followed(self, source: View, target: View, places: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Displacements of places [N, 2], which of them are followed on tissue [N], and how far the tool is [N]."""
        one, other = self._shown(source), self._shown(target)
        step, known = self._linker.followed(one.gray, other.gray, places)
        inside = ((places >= -0.5) & (places < np.array(one.gray.shape[::-1]) - 0.5)).all(axis=1)
        tissue = values_at(source[1], np.rint((places + 0.5) * self._scale(source) - 0.5)) == TISSUE
        # What lands under the tool would be the tool's own motion.
        known &= inside & tissue & ~values_at(other.tool, np.rint(places + step))
        return step, known, values_at(one.away, np.rint(places))

    def _shown(self, view: View) -> Shown:
        """A picture as it is followed; that of the latest two is remembered."""
        picture, labels = view
        found = next((shown for known, shown in self._latest if known is picture), None)
        if found is None:
            found = Shown.of(picture, labels == TOOL)
            self._latest.append((picture, found))
        return found

    def _scale(self, view: View) -> np.ndarray:
        """Width and height of a picture over those of the one in which its points are followed, [2]."""
        return np.divide(view[1].shape[::-1], self._shown(view).gray.shape[::-1])


def _within(picture: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points [..., 2] that lie in a picture [H, W], others not a number."""
    inside = ((points >= -0.5) & (points < np.array(picture.shape[::-1]) - 0.5)).all(axis=-1, keepdims=True)
    return np.where(inside, points, np.nan)
