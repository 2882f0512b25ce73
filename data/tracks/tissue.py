"""Tracks of tissue points from frame to frame, so that the same tissue is observed and not the tool's motion.

Bini 2026 (section 3.2) compares contact points that are detected anew in each frame; these slide over the tissue with
the tool. Here a point moves as most of the tissue around it, by `data.tracks.linking`. That drifts from frame to frame,
so the point is also found again by the pattern of the tissue around it.
"""

from __future__ import annotations

import cv2
import numpy as np

from palpate.data.labels import TISSUE
from palpate.data.tracks.following import EDGED, Shown, values_at
from palpate.data.tracks.linking import WINDOW, followed

HALF_WIDTH = 32
"""Half side of the patch by which a point is found again [px]."""
REACH = 8
"""Largest correction along each axis [px]."""


class TissueTracker:
    """Moves tissue points of one clip between its pictures; points are (u, v) in pixels of the full pictures."""

    def near(self, source: Shown, target: Shown, point: np.ndarray) -> np.ndarray:
        """Move a point [2] of one picture into another one as the tissue around it moves.

        Args:
            source, target: the pictures.
            point: in the first of them.

        Returns:
            Shape [2]; NaN where too little tissue is tracked.
        """
        if not np.isfinite(point).all():
            return np.full(2, np.nan)
        offsets = np.mgrid[-32:33:4, -32:33:4].reshape(2, -1).T.astype(np.float64)
        step, away = self._followed(source, target, _small(source, point) + offsets)
        distance = np.linalg.norm(offsets, axis=1)
        # Wider neighbourhoods are used if too little of the narrower is tracked, the tool's edge only in the end.
        for least, radius in ((EDGED, 8.0), (EDGED, 16.0), (EDGED, 32.0), (0, 32.0)):
            around = step[(away > least) & (distance <= radius)]
            used = around[np.isfinite(around).all(axis=1)]
            if len(used) >= max(8, 0.2 * len(around)):
                return _within(target.size, point + np.median(used, axis=0) * _scale(source))
        return np.full(2, np.nan)

    def each(self, source: Shown, target: Shown, points: np.ndarray) -> np.ndarray:
        """Places in another picture of points [P, 2] of one, each for itself; NaN where they are lost."""
        step, _ = self._followed(source, target, _small(source, points))
        return _within(target.size, points + step * _scale(source))

    def template(self, shown: Shown, point: np.ndarray) -> TissueTemplate:
        """Template of the tissue around a point [2] of a picture."""
        return TissueTemplate(shown.gray, _apart(shown), _small(shown, point))

    def again(self, template: TissueTemplate, shown: Shown, near: np.ndarray) -> np.ndarray:
        """The point of a template in another picture, close to `near` [2], or `near` itself where nothing matches."""
        found = template.locate(shown.gray, _apart(shown), _small(shown, near))
        return near if found is None else (found + 0.5) * _scale(shown) - 0.5

    def _followed(self, one: Shown, other: Shown, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Displacements of places [N, 2], NaN where they are lost; how far the tool is [N], -1 off tissue."""
        step, known = followed(one.flat, other.flat, places, WINDOW)
        usable = np.isfinite(_within(one.gray.shape[::-1], places)[:, 0])
        usable &= values_at(one.labels == TISSUE, np.rint(places))
        # What lands under the tool would be the tool's own motion.
        known &= usable & ~values_at(other.tool, np.rint(places + step))
        return np.where(known[:, None], step, np.nan), np.where(usable, values_at(one.away, np.rint(places)), -1.0)


def _apart(shown: Shown) -> np.ndarray:
    """Mask of tissue away from the tool's edge, bool [H, W]."""
    return (shown.labels == TISSUE) & (shown.away > EDGED)


def _scale(shown: Shown) -> np.ndarray:
    """Width and height of a picture over those of the one in which its points are followed, [2]."""
    return np.divide(shown.size, shown.gray.shape[::-1])


def _small(shown: Shown, points: np.ndarray) -> np.ndarray:
    """Points [..., 2] in pixels of the picture in which they are followed."""
    return (points + 0.5) / _scale(shown) - 0.5


class TissueTemplate:
    """A patch of tissue that is found again by normalised correlation, pixels of the tool left out in both frames."""

    def __init__(self, picture: np.ndarray, usable: np.ndarray, point: np.ndarray) -> None:
        """
        Args:
            picture: uint8, shape [H, W].
            usable: mask of tissue away from the tool, shape [H, W].
            point: (u, v) [px].
        """
        self._offset = point - np.rint(point)
        self._patch, self._usable = _crop(picture, usable, np.rint(point).astype(int), HALF_WIDTH)

    def locate(self, picture: np.ndarray, usable: np.ndarray, near: np.ndarray) -> np.ndarray | None:
        """The point in another picture, within REACH of `near` (u, v), or None where nothing matches well.

        Returns:
            (u, v) [px], to a fraction of a pixel.
        """
        centre = np.rint(near - self._offset).astype(int)
        score = _correlation(self._patch, self._usable, *_crop(picture, usable, centre, HALF_WIDTH + REACH))
        row, column = np.unravel_index(np.argmax(score), score.shape)
        inside = 0 < row < 2 * REACH and 0 < column < 2 * REACH
        if not inside or score[row, column] < 0.7:
            return None
        across = _peak(score[row, column - 1 : column + 2])
        down = _peak(score[row - 1 : row + 2, column])
        return centre + self._offset + (column + across - REACH, row + down - REACH)


def _crop(picture: np.ndarray, usable: np.ndarray, centre: np.ndarray, radius: int) -> tuple[np.ndarray, np.ndarray]:
    """Square around a pixel of a picture, float32, and of the mask of usable pixels; outside there are none."""
    left, top = centre + radius
    window = np.s_[top : top + 2 * radius + 1, left : left + 2 * radius + 1]
    return np.pad(picture, 2 * radius)[window].astype(np.float32), np.pad(usable, 2 * radius)[window]


def _correlation(patch: np.ndarray, known: np.ndarray, picture: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Normalised correlation of a patch at every shift within a larger picture, over the pixels usable in both.

    Args:
        patch, known: grey values and usable pixels of the patch, shape [2R+1, 2R+1].
        picture, usable: pattern and mask of the picture, shape [S, S].

    Returns:
        Shape [S-2R, S-2R]; -1 where too few pixels are usable.
    """
    # Around the patch's mean, so that single precision loses nothing to the square of a large mean.
    middle = float(patch[known].mean()) if known.any() else 0.0
    ours, theirs = known.astype(np.float32), usable.astype(np.float32)
    first, second = (patch - middle) * ours, (picture - middle) * theirs

    def total(large: np.ndarray, small: np.ndarray) -> np.ndarray:
        return cv2.matchTemplate(large, small, cv2.TM_CCORR).astype(np.float64)

    count = np.rint(total(theirs, ours))
    safe = np.maximum(count, 1)
    mean_first, mean_second = total(theirs, first) / safe, total(second, ours) / safe
    covariance = total(second, first) / safe - mean_first * mean_second
    spread = total(theirs, first * first) / safe - mean_first**2
    spread *= total(second * second, ours) / safe - mean_second**2
    enough = (count >= 0.3 * patch.size) & (spread > 1e-6)
    return np.where(enough, covariance / np.sqrt(np.where(enough, spread, 1)), -1)


def _peak(values: np.ndarray) -> float:
    """Place of a parabola's peak through three values at -1, 0, 1."""
    curvature = values[0] - 2 * values[1] + values[2]
    return 0.0 if curvature >= 0 else float(np.clip(0.5 * (values[0] - values[2]) / curvature, -0.5, 0.5))


def _within(size: tuple[int, ...], points: np.ndarray) -> np.ndarray:
    """Points [..., 2] that lie in a picture of a width and height, others NaN."""
    inside = ((points >= -0.5) & (points < np.array(size) - 0.5)).all(axis=-1, keepdims=True)
    return np.where(inside, points, np.nan)
