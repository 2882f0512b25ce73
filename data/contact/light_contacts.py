"""Contacts by the light of the tissue: a press tilts it and pushes it away, so that it darkens next to the instrument.

Light is compared with the median of the frames before, place by place, so that neither albedo nor exposure counts. A
dent that has come next to an instrument is a press, and so is one that an instrument has hidden and leaves behind;
where nothing has changed, none is. What a pull does to tissue hardly shows in its light: that is for
`data.contact.evidence`, whose word counts where it is sure.
"""

import math
from collections import deque
from collections.abc import Sequence
from functools import cache

import numpy as np

from palpate.common.robust import median_sd
from palpate.data.contact.evidence import CERTAIN
from palpate.data.contact.geometry import GeometrySettings
from palpate.data.contact.lit_frame import ARRIVED, REACH, LitFrame, centre, darkest, darkness_of, lie_together
from palpate.data.prepared import PreparedFrame
from palpate.data.shading.light import FINE, brightness, log_light
from palpate.data.shading.registration import Registration, View
from palpate.data.shading.sequence import DARKER, RestingLight, change_of_light, smoothed
from palpate.data.source.camera import Camera

SHADOW, SHADOWS = 1.5, 8
"""A dent is darker than shadows, by this factor: than what darkened next to an instrument in the last so many frames
in which one moved."""
CLEAR = 6.0
"""A dent is darker than at rest by at least DARKER and by so many standard deviations of the noise."""
FIRST, FEWEST_REST = 6, 3
"""Frames that are waited for at first, and the earliest of them, which are taken to show tissue at rest."""
BEGINS = 3
"""Successive frames with a dent that make a press."""
EARLIEST, HIDDEN_FOR = 3, 8
"""Frames by which a press begins before its dent shows next to the instrument, at most, if the instrument has come to
the tissue by then; and at most where the instrument hides the dent's middle."""
BARED, HELD = 2, 20
"""Successive frames that show a dent where an instrument was, and how many frames wait at most for it to go."""
UNCHANGED = "The tissue at the instrument is as bright as at rest, so nothing presses on it."
NO_DENT = "What is darker next to the instrument is its shadow or tissue that moves along, so nothing presses on it."
LET_GO = "The instrument has let go of the tissue, whose light returns to that at rest."


class LightContacts:
    """Decides frames by the light of tissue, five frames late; while an instrument is at tissue, up to twenty.

    Every frame keeps what is known otherwise.

    Args:
        camera: intrinsics of the grid.
        settings: of meshes.
    """

    def __init__(self, camera: Camera, settings: GeometrySettings) -> None:
        self._camera, self._settings = camera, settings
        self._rest = RestingLight()
        self._number: int | None = None
        """Number of the frame before."""
        self._registration: Registration | None = None
        self._view: View | None = None
        """View of the frame before."""
        self._first: list[LitFrame] = []
        """The first frames, until there are enough to take the earliest for tissue at rest."""
        self._waiting: list[LitFrame] = []
        """Frames in which a press may have begun."""
        self._place: tuple[int, int] | None = None
        """Row and column [grid pixels] of the dent of the press under way, or that recovers."""
        self._free = False
        """Whether the light at rest is that of tissue without an instrument at it; else one may press all along."""
        self._pressing = False
        """Whether the press still goes on."""
        self._deepest: np.ndarray | None = None
        """The darkest that every place around the dent has been under it."""
        self._pressed_s = -math.inf
        """Time of the last frame under a press [s]."""
        self._tips: list[np.ndarray] = []
        """Where instruments were in the frame before."""
        self._shadows: deque[float] = deque(maxlen=SHADOWS)
        """Darkness of the tissue next to an instrument when it moved last."""

    def push(self, prepared: PreparedFrame) -> list[PreparedFrame]:
        """The next frame; gives those that are decided, in order."""
        if not prepared.visible:
            # Behind a gap the view may be another.
            return [*self._forget(), prepared]
        number, self._number = self._number, prepared.frame.number
        gap = self._forget() if number is not None and not prepared.follows(number) else []
        if self._registration is None:
            self._registration = Registration(prepared.depth.shape)
        view, registered = self._registration.push(prepared.shown)
        another = self._view is not None and view.reference != self._view.reference
        shape = prepared.depth.shape
        prepared.make_light, prepared.light_view = cache(lambda: log_light(*registered(), shape)), view
        self._view = view
        decided = gap + (self._forget() if another else [])
        lit = LitFrame.of(prepared, prepared.make_light, view, registered, self._tips)
        self._tips = lit.tips
        if len(self._rest):
            return decided + self._decided(lit)
        self._first.append(lit)
        return decided + (self._begin() if len(self._first) == FIRST else [])

    def _forget(self) -> list[PreparedFrame]:
        """Decide what waits; what comes next can't be compared with it."""
        decided = self.finish()
        self._rest.clear()
        self._shadows.clear()
        self._place, self._free, self._tips = None, False, []
        return decided

    def _begin(self) -> list[PreparedFrame]:
        """The first frames, by the light of the earliest of them."""
        first, self._first = self._first, []
        for lit in first[:FEWEST_REST]:
            self._rest.push(lit.make_light)
        self._free |= 2 * sum(not lit.prepared.in_contact for lit in first[:FEWEST_REST]) > FEWEST_REST
        return [prepared for lit in first for prepared in self._decided(lit)]

    def _decided(self, lit: LitFrame) -> list[PreparedFrame]:
        """The frames that one more decides, in order."""
        # Without instruments, and none before, nothing depends on what the light does.
        looked_at = lit.tips or self._place is not None or any(one.tips for one in self._waiting)
        if len(self._rest) >= FEWEST_REST and looked_at:
            self._compare(lit)
        if self._place is not None:
            self._go_on(lit, self._place)
            return [lit.prepared]
        self._waiting.append(lit)
        dents = [one for one in self._waiting[-BEGINS:] if one.dent is not None]
        if len(dents) == BEGINS and lie_together([one.dent for one in dents]):
            if dents[-1].stands_since(dents[0]):
                return self._begun(dents)
            self._shadows.append(lit.darkness)  # what has darkened goes along with an instrument that moves slowly
        bared = [one for one in self._waiting[-BARED:] if one.bared is not None]
        if len(bared) == BARED and lie_together([one.bared for one in bared]) and not bared[-1].goes_along():
            return self._over(bared)
        return self._at_rest(len(self._waiting) - self._held())

    def _held(self) -> int:
        """Number of the frames that wait that are not decided yet."""
        least = BEGINS + EARLIEST - 1
        at = [index for index, one in enumerate(self._waiting) if one.prepared.in_contact or one.prepared.hovers]
        if not at or len(self._waiting) - 1 - at[-1] > BARED:
            return least
        return max(least, min(len(self._waiting) - at[0], HELD))

    def _begun(self, dents: list[LitFrame]) -> list[PreparedFrame]:
        """The frames that wait, where the last of them show a dent."""
        self._place = centre([(one.change, one.dent) for one in dents])
        before = self._waiting[-BEGINS - 1 :: -1]
        before = before[_went_along(before, dents[0]) :]
        if dents[0].is_half_hidden():
            at_tissue = [one.is_at(self._place) for one in before[1:HIDDEN_FOR]]
        else:
            at_tissue = [one.prepared.in_contact for one in before[1:EARLIEST]]
        arrived = at_tissue.index(False) if False in at_tissue else len(at_tissue)
        # A dent begins where it is darker than at rest by so many standard deviations, if it is clearly so a frame
        # later.
        arrived += bool(before) and before[0].shows(self._place, 2.0)
        decided = self._at_rest(len(before) - arrived)
        self._pressing, self._deepest = True, None
        for one in self._waiting:
            self._press(one, self._place)
        decided += [one.prepared for one in self._waiting]
        self._waiting = []
        return decided

    def _over(self, bared: list[LitFrame]) -> list[PreparedFrame]:
        """The frames that wait, where the last of them show the dent that an instrument has left behind."""
        place = centre([(one.change, one.bared) for one in bared])
        last = len(self._waiting) - BARED
        while last and not self._waiting[last - 1].is_at(place):
            last -= 1
        first = last
        while first and self._waiting[first - 1].is_at(place):
            first -= 1
        if first == last:
            return self._at_rest(len(self._waiting) - self._held())
        moves = [one.moves for one in self._waiting[first:last]]
        if False in moves:  # the tip stops where the tissue is, and goes when it lets go
            last -= moves[::-1].index(False)
            first += max(moves.index(False) - 1, 0)
        decided, pressed = self._at_rest(first), last - first
        waited, self._waiting, self._deepest = self._waiting, [], None
        for one in waited[:pressed]:
            self._press(one, place)
        self._place, self._pressing = place, False
        for one in waited[pressed:]:
            self._go_on(one, place)
        return decided + [one.prepared for one in waited]

    def finish(self) -> list[PreparedFrame]:
        """The frames that are left at the clip's end."""
        return self._begin() + self._at_rest(len(self._waiting))

    def _at_rest(self, count: int) -> list[PreparedFrame]:
        """The first so many frames that wait, in which nothing presses."""
        done, self._waiting = self._waiting[: max(count, 0)], self._waiting[max(count, 0) :]
        for lit in done:
            if lit.dent is None:
                self._rest.push(lit.make_light)
                self._free |= not lit.prepared.in_contact
                if self._free and lit.change is not None and not lit.prepared.contact_probability >= CERTAIN:
                    _out_of_contact(lit.prepared, UNCHANGED if lit.darkness < DARKER else NO_DENT)
        return [lit.prepared for lit in done]

    def _compare(self, lit: LitFrame) -> None:
        """Look for a dent next to an instrument, or where one was."""
        change = change_of_light(brightness(lit.make_light()), brightness(self._rest.median()))
        if change is None:
            return
        mean = smoothed(change)
        # Far from an instrument the change's noise is measured.
        far = mean[(lit.away > 12.0) & np.isfinite(mean)]
        noise = median_sd(far) if far.size else math.inf
        # Tissue moves all over, or the light flickers: nothing can be said.
        if noise > 0.03:
            return
        lit.change, lit.noise = mean, noise
        least = max(DARKER, CLEAR * noise)
        lit.darkness = darkest(mean, lit.near <= REACH)[1]
        place, darkness, dark = darkest(mean, lit.standing <= REACH)
        if dark and darkness > least:
            lit.dark = place
        was = [one.near <= ARRIVED for one in self._waiting]
        if was:
            bared, left, dark = darkest(mean, np.any(was, axis=0) & (lit.away > REACH))
            if dark and left > least and not (lit.dark is not None and lie_together([lit.dark, bared])):
                lit.bared = bared
        if lit.bared is not None and lit.moves:
            self._shadows.clear()  # a shadow goes along and leaves nothing behind
        if lit.dark is not None and darkness > SHADOW * max(self._shadows, default=0.0):
            lit.dent = place
        elif lit.moves and lit.bared is None and self._place is None:
            self._shadows.append(lit.darkness)

    def _press(self, lit: LitFrame, place: tuple[int, int]) -> None:
        """A frame under the press."""
        prepared = lit.prepared
        inside = np.array(prepared.depth.shape) - 1
        row, column = np.rint(lit.view.back(np.array(place))).astype(int).clip(0, inside).tolist()
        pixel = column, row
        change, self._pressed_s = lit.change_around(place), prepared.frame.time_s
        if change is not None:
            self._deepest = change if self._deepest is None else np.fmin(self._deepest, change)
        prepared.contact_probability, prepared.undecided = 0.95, False
        if prepared.press_at(pixel, self._camera, self._settings):
            prepared.press = pixel

    def _go_on(self, lit: LitFrame, place: tuple[int, int]) -> None:
        """Whether the press goes on in a frame, has ended, or its dent has recovered."""
        change = lit.change_around(place)
        darkness, away = darkness_of(change), lit.away[FINE * place[0], FINE * place[1]]
        # What the instrument hides now doesn't count: its mask changes while it stands.
        dent = None if change is None or self._deepest is None else np.where(np.isfinite(change), self._deepest, np.nan)
        # A press has ended where less than this share of the darkness is left, or the instrument has gone.
        if self._pressing and away <= REACH and not darkness < 0.35 * darkness_of(dent):
            self._press(lit, place)
            return
        self._pressing = False
        _out_of_contact(lit.prepared, LET_GO)
        if darkness < 0.03:
            self._place = None
        # After this time what is left of a dent counts as the tissue at rest [s].
        elif lit.prepared.frame.time_s - self._pressed_s > 1.0:
            # Something else has darkened the tissue: what it is like at rest isn't known any more.
            self._forget()


def _went_along(before: Sequence[LitFrame], first: LitFrame) -> int:
    """Number of frames before the first that shows a dent, latest first, that are under the same press.

    The instrument goes along with a dent in oblique tissue, and bares a part of it. A dent that the instrument hides
    all but the edge of may not show in a single frame.
    """
    count, since = 0, 0
    for index, lit in enumerate(before):
        if any(place is not None and lie_together([place, first.dent]) for place in (lit.bared, lit.dent)):
            count, since = index + 1, 0
        elif lit.dark is None or not lie_together([lit.dark, first.dent]):
            since += 1
        if since > 1:
            break
    return count


def _out_of_contact(prepared: PreparedFrame, reason: str) -> None:
    """Reject a contact that outlines show, and light doesn't."""
    if prepared.in_contact or prepared.hovers:
        prepared.status, prepared.detail, prepared.geometry = "no_contact", reason, None
        prepared.contact_probability, prepared.undecided = math.nan, False
