"""Presses found by the colour of the tissue: the walls of a dent light each other, so that it reddens as it darkens.

Colour is compared with the median of earlier frames, place by place, so that neither albedo nor exposure counts. A
shadow darkens tissue and keeps its colour, and a part of an instrument that its mask leaves out is paler than tissue.
A press is a dent in which an instrument stands: pictures around the dent change as the instrument comes and as it goes.
Pulls hardly change colours; they are decided by `data.contact.evidence`, whose certain contacts are kept.
"""

import math
from functools import cache
from itertools import pairwise

import numpy as np

from palpate.common.robust import median_sd
from palpate.data.contact.evidence import CERTAIN
from palpate.data.contact.geometry import GeometrySettings
from palpate.data.contact.lit_frame import FAR, REDDER, LitFrame
from palpate.data.prepared import PreparedFrame
from palpate.data.shading.light import brightness, log_light, redness
from palpate.data.shading.registration import Registration, View
from palpate.data.shading.sequence import RestingLight, change_of_light, smoothed
from palpate.data.source.camera import Camera

FIRST, FEWEST_REST = 6, 3
"""Frames that are waited for at first, and the earliest of them, which are taken to show tissue at rest."""
BEGINS, STAYS = 3, 2.0
"""Successive frames with a dent that make a press, and how far its middle may move meanwhile [grid pixels]."""
HELD, LEAST_HELD = 20, 5
"""Frames that wait at most, while an instrument is in view, and at least."""
STANDS = 0.3
"""An instrument stands where less than this share of what moved when it came moves."""
LEAST_MOVED = 20
"""Fewer places of the lattice that show something else are no instrument that comes or goes."""
UNCHANGED = "The tissue at the instrument has the colour that it has at rest, so nothing presses on it."


class LightContacts:
    """Contact by the colour of tissue, decided five frames late; up to twenty while an instrument is in view.

    Frames keep what is known otherwise where colour decides nothing.

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
        """First frames, until there are enough to take the earliest for tissue at rest."""
        self._waiting: list[LitFrame] = []
        """Frames in which a press may have begun."""
        self._press = False
        """True while a press is under way."""
        self._place = np.zeros(2)
        """Row and column [grid pixels] of its dent, or of the last one."""
        self._deepest, self._most = 0.0, 0
        """Largest change under that press, and how much moved when its instrument came."""
        self._last: LitFrame | None = None
        """Last frame under it, or in which its instrument leaves."""
        self._free = False
        """True where the light at rest is that of tissue without an instrument at it; else one may press all along."""

    def push(self, prepared: PreparedFrame) -> list[PreparedFrame]:
        """Take the next frame; return those that are decided, in order."""
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
        lit = LitFrame.of(prepared, prepared.make_light, view, registered)
        return decided + self._next(lit)

    def _next(self, lit: LitFrame) -> list[PreparedFrame]:
        """Take a frame of the same view; return those that are decided."""
        if not self._press and self._last is not None:
            leaves, self._last = self._moves(lit, self._last), lit
            if leaves:
                self._reject(lit.prepared)
                return [lit.prepared]
            self._last = None
        if len(self._rest):
            return self._decided(lit)
        self._first.append(lit)
        return self._begin() if len(self._first) == FIRST else []

    def _forget(self) -> list[PreparedFrame]:
        """Decide what waits; what comes next can't be compared with it."""
        decided = self.finish()
        self._rest.clear()
        self._press, self._last, self._free = False, None, False
        return decided

    def _begin(self) -> list[PreparedFrame]:
        """Decide the first frames by the light of the earliest of them."""
        first, self._first = self._first, []
        for lit in first[:FEWEST_REST]:
            self._rest.push(lit.make_light)
        self._free |= 2 * sum(not lit.prepared.in_contact for lit in first[:FEWEST_REST]) > FEWEST_REST
        return [prepared for lit in first for prepared in self._decided(lit)]

    def _decided(self, lit: LitFrame) -> list[PreparedFrame]:
        """Return the frames that one more decides, in order."""
        # Without instruments nothing depends on what the colour does; frames right before them are compared, too.
        frames = [*self._waiting, lit]
        if len(self._rest) >= FEWEST_REST and (self._press or any(np.isfinite(one.near).any() for one in frames)):
            for one in frames:
                if not one.compared:
                    self._compare(one)
        if self._press:
            return [lit.prepared] if self._goes_on(lit) else self._ended([lit])
        self._waiting.append(lit)
        dents = [one.dent for one in self._waiting[-BEGINS:] if one.dent is not None]
        if len(dents) == BEGINS and np.linalg.norm(np.subtract(dents, dents[-1]), axis=1).max() < STAYS:
            return self._begun(dents[-1])
        return self._at_rest(len(self._waiting) - self._held())

    def _held(self) -> int:
        """Return the number of the frames that wait that are not decided yet."""
        at = [index for index, one in enumerate(self._waiting) if np.isfinite(one.near).any()]
        if not at or len(self._waiting) - 1 - at[-1] > BEGINS:
            return LEAST_HELD
        return max(LEAST_HELD, min(len(self._waiting) - at[0] + BEGINS, HELD))

    def _begun(self, place: np.ndarray) -> list[PreparedFrame]:
        """Decide the frames that wait, where the last of them show a dent at a place."""
        waiting = self._waiting
        change = np.array([one.change_at(place) for one in waiting])
        moved = np.array([0, *(now.moved(before, place) for before, now in pairwise(waiting))])
        run = dwell(change, moved, waiting[-1].noise)
        if run is None or np.median([one.distance(place) for one in waiting[slice(*run)]]) > FAR:
            return self._at_rest(len(waiting) - self._held())
        self._press, self._place = True, place
        self._most, self._deepest = int(moved.max()), float(np.nanmax(change))
        # Its dent was seen to come, so nothing pressed before.
        self._free |= run[0] > 0
        decided = self._at_rest(run[0])
        pressed, later = waiting[slice(*run)], waiting[run[1] :]
        self._waiting, self._last = [], pressed[-1]
        for one in pressed:
            self._take(one, place)
        decided += [one.prepared for one in pressed]
        return decided + (self._ended(later) if later else [])

    def _ended(self, later: list[LitFrame]) -> list[PreparedFrame]:
        """Start anew with the frames after a press, when its instrument has left.

        Its dent as it recovers is tissue at rest from then on.
        """
        self._press, self._free = False, True
        self._rest.clear()
        return [prepared for lit in later for prepared in self._next(lit)]

    def _moves(self, lit: LitFrame, before: LitFrame) -> bool:
        """Return whether the instrument of the last press moves."""
        return lit.moved(before, self._place) > STANDS * self._most

    def _goes_on(self, lit: LitFrame) -> bool:
        """Return whether a frame is under the press that is under way."""
        change, before = lit.change_at(self._place), self._last or lit
        self._deepest = max(self._deepest, change) if math.isfinite(change) else self._deepest
        # A press has ended where less than this share of the change is left, or its instrument moves.
        if change < 0.35 * self._deepest or self._moves(lit, before):
            return False
        self._take(lit, self._place)
        self._last = lit
        return True

    def finish(self) -> list[PreparedFrame]:
        """Return the frames that are left at the clip's end."""
        return self._begin() + self._at_rest(len(self._waiting))

    def _at_rest(self, count: int) -> list[PreparedFrame]:
        """Return the first so many frames that wait, in which nothing presses."""
        done, self._waiting = self._waiting[: max(count, 0)], self._waiting[max(count, 0) :]
        for lit in done:
            self._rest.push(lit.make_light)
            prepared = lit.prepared
            self._free |= not prepared.in_contact
            if self._free and lit.change is not None and not prepared.contact_probability >= CERTAIN:
                self._reject(prepared)
        return [lit.prepared for lit in done]

    @staticmethod
    def _reject(prepared: PreparedFrame) -> None:
        """Reject a contact that outlines show, and light doesn't."""
        if prepared.in_contact or prepared.hovers:
            prepared.dismiss(UNCHANGED)

    def _compare(self, lit: LitFrame) -> None:
        """Look for a dent around instruments and where they were."""
        lit.compared = True
        darker, redder = (
            change_of_light(quantity(lit.make_light()), quantity(self._rest.median(without=2)))
            for quantity in (brightness, redness)
        )
        if darker is None or redder is None:
            return
        redder, darker = smoothed(redder, darker), smoothed(darker)
        # Far from an instrument noise is measured.
        far = (lit.near > 12.0) & np.isfinite(redder)
        noises = [median_sd(part[far]) if far.any() else math.inf for part in (redder, darker)]
        # Tissue moves all over, or the light flickers: nothing can be said.
        if max(noises) > 0.03:
            return
        lit.change, lit.noise = redder, noises[0]
        # A dent is redder than at rest by so many standard deviations, too.
        lit.look(np.any([one.near < FAR for one in [*self._waiting, lit]], axis=0), max(REDDER, 6.0 * lit.noise))

    def _take(self, lit: LitFrame, place: np.ndarray) -> None:
        """Count a frame as one under the press."""
        prepared = lit.prepared
        inside = np.array(prepared.depth.shape) - 1
        row, column = np.rint(lit.view.back(place)).astype(int).clip(0, inside).tolist()
        prepared.contact_probability, prepared.undecided = 0.95, False
        if prepared.press_at((column, row), self._camera, self._settings):
            prepared.press = column, row


def dwell(change: np.ndarray, moved: np.ndarray, noise: float) -> tuple[int, int] | None:
    """Return the first of N frames in which an instrument stands in its dent, and the one after the last.

    None where no instrument comes, stands for a while, and leaves or makes a dent.

    Args:
        change: of the colour at the dent's place, shape [N]; not a number where it is hidden.
        moved: how much moves around it since the frame before, shape [N].
        noise: standard deviation of the change.
    """
    known = change[np.isfinite(change)]
    if not len(known) or moved.max() < LEAST_MOVED:
        return None
    most = float(known.max())
    least = max(0.1 * most, 3 * noise, 0.5 * REDDER)
    moves = moved > STANDS * moved.max()
    ends = np.flatnonzero(np.diff(np.concatenate([[True], moves, [True]]).astype(int)))
    for first, end in ends.reshape(-1, 2):
        shown, before = change[first:end], change[:first][np.isfinite(change[:first])]
        dented = np.nanmax([*shown, *change[end : end + BEGINS + 1], 0.0])
        absent = shown[-1] < least or (shown < least).mean() > 0.5
        # What has reddened while the instrument still moved is a part of it, or what it has left behind.
        first_shown = [*shown[np.isfinite(shown)], most][0]
        old = before[-1] >= 0.8 * most if len(before) else first_shown >= 0.2 * most
        if end - first < BEGINS or absent or old or dented < 0.2 * most:
            continue
        # It may have come some time before its dent shows.
        begins = first + max(int(np.argmin(shown < least)) - BEGINS, 0)
        if begins == first and first:  # in the frame in which it meets the tissue it has moved for a part of the time
            begins -= int(first < 2 or not moves[first - 2] or moved[first - 1] < 0.85 * moved[first - 2])
        still = float(np.median([0.0, *before]))
        earliest = max(begins - BEGINS, 0)
        while begins > earliest and change[begins - 1] - still >= 0.5 * (dented - still):
            begins -= 1
        return int(begins), int(end)
    return None
