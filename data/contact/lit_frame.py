"""A frame and how its light differs from that at rest: where instruments are, and where tissue has darkened."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from palpate.data.contact.tips import tool_tips
from palpate.data.labels import TOOL
from palpate.data.prepared import PreparedFrame
from palpate.data.shading.light import FINE
from palpate.data.shading.registration import View
from palpate.data.tracks.following import lit_field

TIP, LEAST_TIP = 6.0, 6
"""How much of an instrument's free end may press [grid pixels], and the smallest mask of one [grid pixels²]."""
REACH = 6.0
"""A press darkens tissue this near to it [grid pixels]."""
STILL = 1.5
"""An instrument stands that moves less from frame to frame [grid pixels]."""
ARRIVED = 4.0
"""What an instrument may have hidden lies so near to its free end [grid pixels]."""


@dataclass(eq=False)
class LitFrame:
    """A frame and how its light differs from that at rest."""

    prepared: PreparedFrame
    make_light: Callable[[], np.ndarray]
    """Return the light as in `log_light`, in the view of the reference, as all that follows."""
    view: View
    """How the frame's grid lies in the reference's."""
    away: np.ndarray
    """Distance of every place of the lattice from instruments [grid pixels]."""
    near: np.ndarray
    """Distance of every place from instruments' free ends [grid pixels]."""
    standing: np.ndarray
    """Distance of every place from the free ends of instruments that are where one was in the frame before."""
    tips: list[np.ndarray]
    """Middle of every instrument's free end, row and column [grid pixels]."""
    moves: bool
    """Whether one of them has moved since."""
    change: np.ndarray | None = None
    """Logarithm of light over that at rest, averaged around every place; None where it isn't known, or where so much
    changes that a dent would not show."""
    noise: float = math.inf
    """Its standard deviation where nothing changes."""
    dark: tuple[int, int] | None = None
    """Row and column of the darkest place of the lattice next to an instrument that stands; None where nothing is
    clearly darker than at rest."""
    dent: tuple[int, int] | None = None
    """Row and column of the darkest place that is darker than a shadow."""
    bared: tuple[int, int] | None = None
    """Row and column of the darkest place where an instrument was in a frame that waits, and isn't now."""
    darkness: float = 0.0
    """How much darker than at rest the darkest place next to an instrument is."""

    @classmethod
    def of(
        cls,
        prepared: PreparedFrame,
        make_light: Callable[[], np.ndarray],
        view: View,
        registered: Callable[[], tuple[np.ndarray, np.ndarray]],
        before: Sequence[np.ndarray],
    ) -> "LitFrame":
        """A frame and where its instruments are; nothing is compared yet.

        Args:
            registered: returns picture and labels in the view of the reference.
            before: the tips in the frame before.
        """
        size = prepared.labels.shape[::-1]
        tool, ends, standing = np.zeros((3, *prepared.labels.shape), bool)
        tips, moves, found = [], False, []
        if prepared.shown.tool.any():
            picture, labels = registered()
            tool = cv2.resize((labels == TOOL).astype(np.uint8), size, interpolation=cv2.INTER_NEAREST_EXACT) > 0
            found = tool_tips(tool, cv2.resize(lit_field(picture).astype(np.uint8), size) > 0, TIP, LEAST_TIP)
        for tip in found:
            middle = tip.mean(axis=0)[::-1]
            stands = any(np.linalg.norm(middle - other) < STILL for other in before)
            ends[tip[:, 1], tip[:, 0]] = True
            standing[tip[:, 1], tip[:, 0]] = stands
            tips.append(middle)
            moves |= not stands
        away, near, still = (distance_from(mask, (FINE * size[1], FINE * size[0])) for mask in (tool, ends, standing))
        return cls(prepared, make_light, view, away, near, still, tips, moves)

    def change_around(self, place: tuple[int, int]) -> np.ndarray | None:
        """The change of the light around a dent's place [grid pixels], [h, w]; None where it isn't known."""
        if self.change is None:
            return None
        (top, left), reach = (FINE * part for part in place), round(FINE * REACH / 2)
        return self.change[max(top - reach, 0) : top + reach + 1, max(left - reach, 0) : left + reach + 1]

    def shows(self, place: tuple[int, int], clear: float) -> bool:
        """Whether a place [grid pixels] is darker than at rest by so many standard deviations."""
        return self.change is not None and bool(self.change[FINE * place[0], FINE * place[1]] < -clear * self.noise)

    def is_at(self, place: tuple[int, int]) -> bool:
        """Whether an instrument is at a place [grid pixels]."""
        return bool(self.near[FINE * place[0], FINE * place[1]] <= REACH)

    def stands_since(self, first: "LitFrame") -> bool:
        """Whether the instrument next to the dent is where one was some frames before."""
        if self.dent is None or not self.tips or not first.tips:
            return False
        tip = min(self.tips, key=lambda each: float(np.linalg.norm(each - np.array(self.dent) / FINE)))
        return bool(np.linalg.norm(np.array(first.tips) - tip, axis=1).min() < STILL)

    def goes_along(self) -> bool:
        """Whether an instrument moves that is still near to what it has bared, so that it may go with the dent."""
        return self.moves and self.bared is not None and bool(self.away[self.bared] <= 2 * REACH)

    def is_half_hidden(self) -> bool:
        """Whether a frame's dent is darkest right next to what doesn't show."""
        if self.change is None or self.dent is None:
            return False
        row, column = self.dent
        around = self.change[max(row - FINE, 0) : row + FINE + 1, max(column - FINE, 0) : column + FINE + 1]
        return bool(np.isnan(around).any())


def distance_from(tool: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Distance from an instrument's mask [h, w] on a lattice over its grid, in the shape asked for [grid pixels].

    Infinite where there is none.
    """
    if not tool.any():
        return np.full(shape, np.inf)
    return cv2.resize(cv2.distanceTransform((~tool).astype(np.uint8), cv2.DIST_L2, 3), shape[::-1])


def darkness_of(change: np.ndarray | None) -> float:
    """How much darker than at rest the darkest place of a change of the light is; NaN where none is known."""
    return math.nan if change is None or not np.isfinite(change).any() else -float(np.nanmin(change))


def lie_together(places: Sequence[tuple[int, int] | None]) -> bool:
    """Whether places of the lattice are those of one dent."""
    known = np.array([place for place in places if place is not None])
    return bool(np.linalg.norm(known - known[-1], axis=1).max() <= FINE * REACH)


def darkest(change: np.ndarray, where: np.ndarray) -> tuple[tuple[int, int], float, bool]:
    """Row and column of the darkest of some places of the lattice, how much darker than at rest it is, and whether they
    darken rather than brighten.
    """
    found = np.where(where & np.isfinite(change), change, 0.0)
    row, column = divmod(int(np.argmin(found)), found.shape[1])
    darkness = -float(found[row, column])
    # A press brightens no tissue by more than this share of what it darkens other tissue by; tissue that is pulled
    # along shows its texture elsewhere, and does both.
    return (row, column), darkness, float(found.max()) < 0.5 * darkness


def centre(dents: Sequence[tuple[np.ndarray | None, tuple[int, int] | None]]) -> tuple[int, int]:
    """Row and column [grid pixels] of a dent's middle: the weighted mean of what has darkened in some frames.

    Args:
        dents: the change of every frame's light, and its darkest place.
    """
    total = np.sum([np.clip(np.nan_to_num(change), -1, 0) for change, _ in dents if change is not None], axis=0)
    row, column = dents[-1][1] or (0, 0)
    reach = round(FINE * 4)
    top, left = max(row - reach, 0), max(column - reach, 0)
    weights = -total[top : row + reach + 1, left : column + reach + 1]
    weights = np.where(weights > 0.3 * weights.max(), weights, 0.0)
    places = np.indices(weights.shape).reshape(2, -1) + np.array([[top], [left]])
    middle = places @ weights.ravel() / max(weights.sum(), 1e-9)
    row, column = np.rint((middle + 0.5) / FINE - 0.5).astype(int).tolist()
    return row, column
