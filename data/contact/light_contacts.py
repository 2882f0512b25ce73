"""Contacts by the light of the tissue: a press tilts it and pushes it away, so that it darkens beside the instrument.

Light is compared with the median of the frames before, place by place, so that neither albedo nor exposure counts. A
dent that has come beside an instrument is a press; where nothing has changed, none is. What a pull does to tissue
hardly shows in its light: that is for `data.contact.evidence`, whose word counts where it is sure.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from palpate.data.brightness.light import FINE, log_light
from palpate.data.brightness.sequence import SPREAD, RestingLight, change_of_light
from palpate.data.contact.dents import dent_geometry
from palpate.data.contact.evidence import CERTAIN
from palpate.data.contact.geometry import GeometrySettings, GeometryStatus
from palpate.data.labels import TOOL
from palpate.data.prepared import PreparedFrame
from palpate.data.source.camera import Camera

WIDTH = 1.0
"""Standard deviation of the weights with which changes are averaged [grid pixels]."""
LEAST_KNOWN = 0.3
"""Share of those weights that must lie on tissue."""
REACH = 6.0
"""A press darkens tissue this near to the instrument's mask [grid pixels]."""
FAR = 12.0
"""Farther from it the change's noise is measured [grid pixels]."""
DARKER, CLEAR = 0.04, 6.0
"""A dent is at least so much darker than at rest, as a logarithm, and by so many standard deviations of the noise."""
FEWEST_REST = 2
"""Frames out of contact from which the light at rest is known."""
NOISIEST = 0.03
"""Where the light changes by more, tissue moves all over or the light flickers: nothing can be said."""
BEGINS = 3
"""Successive frames with a dent that make a press."""
EARLIER, EARLIEST = 1, 3
"""Frames by which a press begins before its dent shows beside the instrument; at most, if the instrument has come to
the tissue by then."""
LEFT = 0.35
"""A press has ended where less than this share of the darkness is left, or the instrument has gone."""
RECOVERED = 0.03
"""Tissue is at rest again where it is darker by less than this."""
PRESSED = 0.95
"""Probability of contact under a press that shows in the light."""
UNCHANGED = "The tissue at the instrument is as bright as at rest, so nothing presses on it."
LET_GO = "The instrument has let go of the tissue, whose light returns to that at rest."


@dataclass(eq=False)
class _LitFrame:
    """A frame and how its light differs from that at rest."""

    prepared: PreparedFrame
    light: np.ndarray
    """As of `log_light`."""
    change: np.ndarray | None = None
    """Logarithm of light over that at rest, averaged around every place; None where it can't be told, or where so much
    changes that a dent would not show."""
    dent: tuple[int, int] | None = None
    """Row and column of the darkest place of the lattice beside an instrument; None where nothing has darkened."""


class LightContacts:
    """Decides frames, up to five late, by the light of tissue; every frame keeps what is known otherwise.

    Args:
        camera: intrinsics of the grid.
        settings: of meshes.
    """

    def __init__(self, camera: Camera, settings: GeometrySettings) -> None:
        self._camera, self._settings = camera, settings
        self._rest = RestingLight()
        self._waiting: list[_LitFrame] = []
        """Frames in which a press may have begun."""
        self._place: tuple[int, int] | None = None
        """Row and column [grid pixels] of the dent of the press under way, or that recovers."""
        self._free = False
        """Whether the light at rest is that of tissue without an instrument at it; else one may press all along."""
        self._pressing, self._deepest = False, 0.0
        """Whether the press still goes on, and how dark the tissue has been since it began."""

    def push(self, prepared: PreparedFrame) -> list[PreparedFrame]:
        """The next frame; gives those that are decided, in order."""
        if not prepared.visible:
            # Behind a gap the view may be another.
            decided = [*self.finish(), prepared]
            self._rest.clear()
            self._place, self._free = None, False
            return decided
        prepared.light = log_light(*prepared.view, prepared.depth.shape)
        lit = _LitFrame(prepared, prepared.light)
        if len(self._rest) >= FEWEST_REST:
            self._compare(lit)
        if self._place is not None:
            self._go_on(lit, self._place)
            return [prepared]
        self._waiting.append(lit)
        dents = [one for one in self._waiting[-BEGINS:] if one.dent is not None]
        if len(dents) < BEGINS:
            return self._at_rest(len(self._waiting) - (BEGINS + EARLIEST - 1))
        self._place = _centre(dents)
        earlier = [one.prepared.in_contact for one in self._waiting[-BEGINS - 2 : -BEGINS - EARLIEST - 1 : -1]]
        arrived = (earlier.index(False) if False in earlier else len(earlier)) + EARLIER
        decided = self._at_rest(len(self._waiting) - BEGINS - arrived)
        self._pressing, self._deepest = True, 0.0
        for one in self._waiting:
            self._press(one, self._place)
        decided += [one.prepared for one in self._waiting]
        self._waiting = []
        return decided

    def finish(self) -> list[PreparedFrame]:
        """The frames that are left at the clip's end."""
        return self._at_rest(len(self._waiting))

    def _at_rest(self, count: int) -> list[PreparedFrame]:
        """The first so many frames that wait, in which nothing presses."""
        done, self._waiting = self._waiting[: max(count, 0)], self._waiting[max(count, 0) :]
        for lit in done:
            if lit.dent is None:
                self._rest.push(lit.light)
                self._free |= not lit.prepared.in_contact
                if self._free and lit.change is not None and not lit.prepared.contact_probability >= CERTAIN:
                    _out_of_contact(lit.prepared, UNCHANGED)
        return [lit.prepared for lit in done]

    def _compare(self, lit: _LitFrame) -> None:
        """Look for a dent beside an instrument."""
        change = change_of_light(lit.light, self._rest.median())
        if change is None:
            return
        known = np.isfinite(change).astype(np.float32)
        weights, sums = (
            cv2.GaussianBlur(part.astype(np.float32), (0, 0), FINE * WIDTH) for part in (known, np.nan_to_num(change))
        )
        mean = np.where(weights >= LEAST_KNOWN, sums / np.maximum(weights, 1e-6), np.nan)
        away = distance_from(lit.prepared.labels == TOOL, mean.shape)
        far = mean[(away > FAR) & np.isfinite(mean)]
        noise = SPREAD * float(np.median(np.abs(far))) if far.size else math.inf
        if noise > NOISIEST:
            return
        lit.change = mean
        near = np.where((away <= REACH) & np.isfinite(mean), mean, 0.0)
        row, column = divmod(int(np.argmin(near)), near.shape[1])
        if near[row, column] < -max(DARKER, CLEAR * noise):
            lit.dent = row, column

    def _press(self, lit: _LitFrame, place: tuple[int, int]) -> None:
        """A frame under the press."""
        prepared, pixel = lit.prepared, place[::-1]
        self._deepest = max(self._deepest, _darkness(lit, place))
        prepared.contact_probability, prepared.undecided = PRESSED, False
        try:
            prepared.geometry = dent_geometry(prepared, pixel, self._camera, self._settings)
        except GeometryStatus as status:
            prepared.status, prepared.detail, prepared.geometry = status.status, status.detail, None
        else:
            prepared.status, prepared.detail, prepared.press = "ok", "", pixel

    def _go_on(self, lit: _LitFrame, place: tuple[int, int]) -> None:
        """Whether the press goes on in a frame, has ended, or its dent has recovered."""
        darkness = _darkness(lit, place)
        away = distance_from(lit.prepared.labels == TOOL, lit.prepared.labels.shape)[place]
        if self._pressing and away <= REACH and darkness >= LEFT * self._deepest:
            self._press(lit, place)
            return
        self._pressing = False
        _out_of_contact(lit.prepared, LET_GO)
        if lit.change is not None and darkness < RECOVERED:
            self._place = None


def distance_from(tool: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Distance from an instrument's mask [h, w] on a lattice over its grid, in the shape asked for [grid pixels].

    Infinite where there is none.
    """
    if not tool.any():
        return np.full(shape, np.inf)
    return cv2.resize(cv2.distanceTransform((~tool).astype(np.uint8), cv2.DIST_L2, 3), shape[::-1])


def _out_of_contact(prepared: PreparedFrame, reason: str) -> None:
    """What outlines take for contact, and light doesn't."""
    if prepared.in_contact or prepared.hovers:
        prepared.status, prepared.detail, prepared.geometry = "no_contact", reason, None
        prepared.contact_probability, prepared.undecided = math.nan, False


def _darkness(lit: _LitFrame, place: tuple[int, int]) -> float:
    """How much darker the tissue around a dent's place [grid pixels] is than at rest; 0 where that isn't known."""
    if lit.change is None:
        return 0.0
    (top, left), reach = (FINE * part for part in place), round(FINE * REACH / 2)
    around = lit.change[max(top - reach, 0) : top + reach + 1, max(left - reach, 0) : left + reach + 1]
    return -float(np.nanmin(around)) if np.isfinite(around).any() else 0.0


def _centre(dents: list[_LitFrame]) -> tuple[int, int]:
    """Row and column [grid pixels] of a dent's middle: the weighted mean of what has darkened in some frames."""
    total = np.sum([np.clip(np.nan_to_num(lit.change), -1, 0) for lit in dents if lit.change is not None], axis=0)
    row, column = dents[-1].dent or (0, 0)
    reach = round(FINE * 4)
    top, left = max(row - reach, 0), max(column - reach, 0)
    weights = -total[top : row + reach + 1, left : column + reach + 1]
    weights = np.where(weights > 0.3 * weights.max(), weights, 0.0)
    places = np.indices(weights.shape).reshape(2, -1) + np.array([[top], [left]])
    middle = places @ weights.ravel() / max(weights.sum(), 1e-9)
    row, column = np.rint((middle + 0.5) / FINE - 0.5).astype(int).tolist()
    return row, column
