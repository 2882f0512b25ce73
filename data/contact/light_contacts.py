"""Contacts by the light of the tissue: a press tilts it and pushes it away, so that it darkens beside the instrument.

Light is compared with the median of the frames before, place by place, so that neither albedo nor exposure counts. A
dent that has come beside an instrument is a press; where nothing has changed, none is. What a pull does to tissue hardly
shows in its light: that is for `data.contact.evidence`, whose word counts where it is sure.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from palpate.data.brightness.light import FINE, log_light
from palpate.data.brightness.sequence import RestingLight, change_of_light
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
EARLIER = 1
"""Frames by which a press begins before its dent shows beside the instrument."""
LEFT = 0.35
"""A press has ended where less than this share of the darkness is left, or the instrument has gone."""
RECOVERED = 0.03
"""Tissue is at rest again where it is darker by less than this."""
PRESSED, UNCHANGED = 0.95, "The tissue at the instrument is as bright as at rest, so nothing presses on it."
"""Probability of contact under a press that shows in the light."""


@dataclass(eq=False)
class _Held:
    """A frame that is not decided yet."""

    prepared: PreparedFrame
    light: np.ndarray | None
    change: np.ndarray | None = None
    """Logarithm of light over that at rest, averaged; not a number where it isn't known."""
    dent: tuple[int, int] | None = None
    """Row and column of the darkest place of the lattice beside an instrument; None where nothing has darkened."""
    quiet: bool = False
    """Whether the light is so steady that a dent would show."""


class LightContacts:
    """Decides frames, up to four late, by the light of tissue; every frame keeps what is known otherwise.

    Args:
        camera: intrinsics of the grid.
        settings: of meshes.
    """

    def __init__(self, camera: Camera, settings: GeometrySettings) -> None:
        self._camera, self._settings = camera, settings
        self._rest = RestingLight()
        self._held: list[_Held] = []
        self._place: tuple[int, int] | None = None
        """Row and column [grid pixels] of the dent of the press under way, or that recovers."""
        self._pressing = False
        self._deepest = 0.0
        """Darkest that the tissue there has been since."""

    def push(self, prepared: PreparedFrame) -> list[PreparedFrame]:
        """The next frame; gives those that are decided, in order."""
        held = _Held(prepared, None)
        if prepared.visible:
            picture, labels = prepared.view
            held.light = prepared.light = log_light(picture, labels, prepared.depth.shape)
            if len(self._rest) >= FEWEST_REST:
                self._compare(held)
        if held.light is None:
            # Behind a gap the view may be another.
            return self._given_up(held)
        self._held.append(held)
        if self._place is not None:
            self._go_on(held)
            return self._released(0)
        dark = [item.dent is not None for item in self._held[-BEGINS:]]
        if len(dark) == BEGINS and all(dark):
            self._begin()
            return self._released(0)
        return self._released(BEGINS + EARLIER - 1)

    def finish(self) -> list[PreparedFrame]:
        """The frames that are left at the clip's end."""
        return self._released(0)

    def _given_up(self, held: _Held) -> list[PreparedFrame]:
        decided = [*self._released(0), held.prepared]
        self._rest.clear()
        self._place, self._pressing = None, False
        return decided

    def _released(self, kept: int) -> list[PreparedFrame]:
        """All frames but the last so many; those without a press are light at rest from now on."""
        count = len(self._held) - kept
        done, self._held = self._held[: max(count, 0)], self._held[max(count, 0) :]
        for held in done:
            if self._place is None or (held.prepared.press is None and not self._pressing and self._recovered(held)):
                self._leave(held)
        return [held.prepared for held in done]

    def _leave(self, held: _Held) -> None:
        """A frame in which nothing presses."""
        prepared = held.prepared
        self._place = None
        if held.light is not None and held.dent is None:
            self._rest.push(held.light)
        touches = prepared.in_contact or prepared.hovers
        if held.quiet and held.dent is None and touches and not prepared.contact_probability >= CERTAIN:
            prepared.status, prepared.detail, prepared.geometry = "no_contact", UNCHANGED, None
            prepared.contact_probability, prepared.undecided = math.nan, False

    def _recovered(self, held: _Held) -> bool:
        return held.change is not None and self._darkness(held) < RECOVERED

    def _darkness(self, held: _Held) -> float:
        """How much darker the dent's place is than at rest, where it is seen around it; 0 where it isn't."""
        if held.change is None or self._place is None:
            return 0.0
        row, column = (FINE * np.array(self._place)).tolist()
        around = held.change[max(row - 6, 0) : row + 8, max(column - 6, 0) : column + 8]
        known = around[np.isfinite(around)]
        return float(-known.min()) if known.size else 0.0

    def _compare(self, held: _Held) -> None:
        """Look for a dent beside an instrument."""
        change = change_of_light(held.light, self._rest.median())
        if change is None:
            return
        known = np.isfinite(change)
        weights = cv2.GaussianBlur(known.astype(np.float32), (0, 0), FINE * WIDTH)
        sums = cv2.GaussianBlur(np.where(known, change, 0).astype(np.float32), (0, 0), FINE * WIDTH)
        mean = np.where(weights >= LEAST_KNOWN, sums / np.maximum(weights, 1e-6), np.nan)
        tool = (held.prepared.labels == TOOL).astype(np.uint8)
        if not tool.any():
            held.change, held.quiet = mean, True
            return
        away = cv2.resize(cv2.distanceTransform(1 - tool, cv2.DIST_L2, 3), mean.shape[::-1])
        far = mean[(away > FAR) & np.isfinite(mean)]
        noise = 1.4826 * float(np.median(np.abs(far))) if far.size else math.inf
        held.quiet = noise < NOISIEST
        if not held.quiet:
            return
        held.change = mean
        near = np.where((away <= REACH) & np.isfinite(mean), mean, 0.0)
        if near.min() < -max(DARKER, CLEAR * noise):
            held.dent = tuple(np.unravel_index(int(np.argmin(near)), near.shape))

    def _begin(self) -> None:
        """A press has begun in the first of the last frames with a dent, or right before."""
        first = len(self._held) - BEGINS
        while first > 0 and self._held[first - 1].dent is not None:
            first -= 1
        dark = self._held[first:]
        self._place = _centre([held.change for held in dark if held.change is not None], dark[-1].dent)
        self._pressing, self._deepest = True, 0.0
        earlier = max(first - EARLIER, 0)
        for held in self._held[:earlier]:
            place, self._place = self._place, None
            self._leave(held)
            self._place = place
        for held in self._held[earlier:]:
            self._press(held)

    def _press(self, held: _Held) -> None:
        prepared = held.prepared
        row, column = self._place
        self._deepest = max(self._deepest, self._darkness(held))
        try:
            geometry = dent_geometry(prepared, (column, row), self._camera, self._settings)
        except GeometryStatus as status:
            prepared.status, prepared.detail, prepared.geometry = status.status, status.detail, None
            return
        prepared.status, prepared.detail, prepared.geometry = "ok", "", geometry
        prepared.contact_probability, prepared.undecided = PRESSED, False
        prepared.press = column, row

    def _go_on(self, held: _Held) -> None:
        """Whether a press goes on in a frame, has ended, or its dent has recovered."""
        prepared = held.prepared
        row, column = self._place
        tool = np.argwhere(prepared.labels == TOOL)
        away = float(np.linalg.norm(tool - [row, column], axis=1).min(initial=math.inf))
        darkness = self._darkness(held)
        if self._pressing and away <= REACH and darkness >= LEFT * self._deepest:
            self._press(held)
            return
        self._pressing = False
        if prepared.in_contact or prepared.hovers:
            prepared.status, prepared.geometry = "no_contact", None
            prepared.detail = "The instrument has let go of the tissue, whose light returns to that at rest."
            prepared.contact_probability, prepared.undecided = math.nan, False


def _centre(changes: list[np.ndarray], dent: tuple[int, int]) -> tuple[int, int]:
    """Row and column [grid pixels] of a dent's middle: the weighted mean of what has darkened around its darkest place.

    Args:
        changes: logarithms of light over that at rest, of some frames.
        dent: row and column of the darkest place of the lattice in the last.
    """
    total = np.nansum([np.clip(np.nan_to_num(change), -1, 0) for change in changes], axis=0)
    row, column = dent
    top, left = max(row - 8, 0), max(column - 8, 0)
    weights = -total[top : row + 9, left : column + 9]
    weights = np.where(weights > 0.3 * weights.max(), weights, 0.0)
    places = np.stack(np.mgrid[: weights.shape[0], : weights.shape[1]], axis=-1) + [top, left]
    middle = (weights[..., None] * places).sum(axis=(0, 1)) / max(weights.sum(), 1e-9)
    row, column = np.rint((middle + 0.5) / FINE - 0.5).astype(int).tolist()
    return row, column
