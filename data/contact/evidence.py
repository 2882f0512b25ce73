"""Contact by evidence: does the tissue next to the tool's tip move with the tool?

Outlines that touch in a picture say little: a tool that passes over tissue touches it there, too. From one picture
to a later one, points in the tool's tip, next to it and far from it are followed (`data.tracks.linking`), and
`data.contact.coupling` gives the likelihood ratio of their motion. A two-state hidden Markov chain adds it up over the
frames. Where the instrument's depth is measured its distance decides instead (`data.contact.clearance`).

Tissue that stays where it is speaks against contact only while the tool moves. A tool that hovered and comes to a stand
may have met the tissue: contact is then undecided, and was so in the frame in which the tool arrived.
"""

import math
from collections import deque

import cv2
import numpy as np

from palpate.data.contact.coupling import TipMotion, log_ratio
from palpate.data.contact.geometry import FrameGeometry
from palpate.data.contact.tips import tool_tips
from palpate.data.prepared import PreparedFrame
from palpate.data.tracks.background import ITERATIONS, LEAST_NOISE, MEDIAN_LENGTH, background_motion
from palpate.data.tracks.following import COARSE, Shown, spread, values_at
from palpate.data.tracks.linking import followed, textured

PRIOR = 0.7
"""Probability that a tool whose outline touches tissue touches it, before anything has moved."""
THRESHOLD = 0.5
"""Below this probability a tool hovers."""
MAX_WAY, MAX_AGE = 5.0, 10
"""Frames are compared with one and the same until the tool has gone so far [px], or for so many frames: what parallax
adds goes to and fro with the camera."""
MAX_LOG_ODDS = 5.0
"""Largest change of the logarithm of the odds by one frame."""
CERTAIN = 0.9
"""Below this probability contact is known from outlines alone: nothing has moved that would confirm it."""
WAITS, FORGETS = 8, 0.03
"""A contact that was not seen to begin, and isn't certain, waits for so many frames to be decided by a later one; by
this share the probability returns to PRIOR in a frame, as contacts begin and end."""
GLIMPSED = "Outlines touch in this frame alone, as where a mask flickers."
HOVERS = "The tissue next to the tool does not move with it, so it hovers (probability of contact {:.2f})."

SPACING = 8
"""Spacing of the tissue's points [px]."""
GUARD = 8.0
"""Points nearer to the tool's mask may be the tool's own, or be followed by its edge [px]."""
RING = 100.0
"""Points nearer than this beyond the guard band are next to the tool, others are the background [px]."""
TIP = 96.0
"""Part of a tool that may touch: this far back from the end which is farthest from where it enters [px]."""
CAMERA_STILL = 0.5
"""A camera that moves less from picture to picture stands still [px]."""
POINTS = 250
"""Points that are followed in a tip, next to it, and in the background, about."""


class ContactEvidence:
    """One clip's probability of contact, frame by frame; a frame's is made of it and the frames before.

    Args:
        near: no farther from tissue in depth, a tool that was apart from it and then is at it in the picture has come
            to it [scene units].
    """

    def __init__(self, near: float = math.inf) -> None:
        self._near = near
        self._reference: tuple[Shown, PreparedFrame] | None = None
        """The frame that frames are compared with until the tool has gone far enough."""
        self._age = 0
        """Frames since then."""
        self._odds = _log_odds(PRIOR)
        """Log odds of contact, by what was observed up to then."""
        self._number = -1
        """Number of the frame that was judged last."""
        self._apart = self._came = False
        """Whether the tool was apart from tissue in that frame, and right before the contact under way began."""
        self._way, self._speed = np.zeros(2), 0.0
        """Way of the tool since the reference [px], and its speed when it hovered last [px a frame]."""
        self._undecided = False
        """Whether the tool hovered, and nothing observed since then decides whether it touches."""
        self._arrives = False
        """Whether the tool may have come to the tissue in the frame before, although it moved until then."""
        self._hovering: tuple[PreparedFrame, FrameGeometry] | None = None
        """The frame before, if its tool was found to hover, and the contact that its outlines show."""
        self._last: list[PreparedFrame] = []
        """Frames that a later one may decide anew, the last one at least."""
        self._touching = deque([False] * (WAITS + 1), maxlen=WAITS + 1)
        """Whether outlines touch in the last frames, as far as these were not dismissed."""

    def push(self, prepared: PreparedFrame) -> list[PreparedFrame]:
        """Judge the next frame; gives those before it that are decided now."""
        follows = prepared.follows(self._number)
        if follows and prepared.status == "no_tool":
            self._dismiss_glimpse()
        self._touching.append(prepared.in_contact)
        self.judge(prepared)
        probability = prepared.contact_probability
        if follows and not self._came and (probability < THRESHOLD or probability >= CERTAIN):
            for age, earlier in enumerate(reversed(self._last), 1):
                self._revise(earlier, probability, (1 - FORGETS) ** age)
        frames, kept = [*self._last, prepared], WAITS if self.waits(prepared) else 1
        self._last = frames[-kept:]
        return frames[:-kept]

    def _dismiss_glimpse(self) -> None:
        """Dismiss the last frame's contact if outlines touched in it alone of many, and nothing else speaks for it."""
        if not self._touching[-1] or sum(self._touching) > 1 or self._came:
            return
        alone = self._last[-1]
        if alone.in_contact and alone.contact_probability <= PRIOR:
            alone.dismiss(GLIMPSED)
            self._touching[-1] = False

    def waits(self, prepared: PreparedFrame) -> bool:
        """Return whether a later frame may decide a frame that was judged."""
        return prepared.in_contact and prepared.contact_probability < CERTAIN and not (self._came or prepared.undecided)

    def finish(self) -> list[PreparedFrame]:
        """The frames that are left at the clip's end."""
        return self._last

    def _revise(self, earlier: PreparedFrame, later: float, stayed: float) -> None:
        """Decide a frame by the probability in a later one, backwards along the chain.

        Args:
            stayed: share of the probability that did not return to PRIOR in between.
        """
        if not (earlier.in_contact and earlier.contact_probability < CERTAIN) or earlier.undecided:
            return
        returned = PRIOR * (1 - stayed)
        earlier.contact_probability = probability = later * (returned + stayed) + (1 - later) * returned
        if probability < THRESHOLD:
            earlier.reject(HOVERS.format(probability))

    def judge(self, prepared: PreparedFrame) -> None:
        """Decide a frame whose outlines touch: its probability, and `no_contact` where the tool hovers.

        The frame before it is decided anew where this one shows that the tool has come to a stand.
        """
        number = prepared.frame.number
        follows = prepared.follows(self._number)
        apart = prepared.status == "no_contact"
        if not (prepared.in_contact and follows):
            # What was known of an earlier contact, or of one before a gap, counts no more.
            self._reference, self._odds, self._age, self._came = None, _log_odds(PRIOR), 0, False
            self._way, self._speed = np.zeros(2), 0.0
            self._undecided, self._hovering = False, None
        if prepared.in_contact and self._apart and follows:
            self._came = True
        self._number, self._apart = number, apart
        if apart and prepared.visible:
            self._begin(prepared.shown, prepared)
        if not prepared.in_contact:
            return
        probability = self._push(prepared.shown, prepared)
        # A tool that was observed to come to the tissue has met it: a narrow dent hardly moves what is around it.
        met = self._came and not prepared.distance > self._near
        probability = prepared.contact_probability = max(probability, PRIOR if met else 0.0)
        if self._arrives and self._hovering is not None:
            arrived, geometry = self._hovering
            arrived.accept(geometry)
            arrived.contact_probability, arrived.undecided = PRIOR, True
        self._hovering = None
        if probability < THRESHOLD:
            self._hovering = prepared, prepared.contact
            prepared.reject(HOVERS.format(probability))
        prepared.undecided = self._undecided and THRESHOLD <= probability < CERTAIN

    def _begin(self, shown: Shown, prepared: PreparedFrame) -> None:
        """Compare the next frames with this one."""
        self._reference, self._age, self._way = (shown, prepared), 0, np.zeros(2)

    def _push(self, shown: Shown, prepared: PreparedFrame) -> float:
        """Probability of contact in the next frame, whose tool is at tissue in the picture."""
        share = 1 / (1 + math.exp(-self._odds))
        self._odds = _log_odds(share + FORGETS * (PRIOR - share))
        before, hovered = self._reference, self._speed > 0
        tips = [] if before is None else observed_motion(before[0], shown)
        self._age += 1
        way = max((tip.tool for tip in tips), key=np.linalg.norm, default=np.full(2, math.nan))
        # A tool that hovered has come to a stand where it moves by less than this share of its speed until then.
        stands = hovered and bool(np.linalg.norm(way - self._way) < 0.25 * self._speed)
        # Tissue that doesn't move says nothing next to a tool that doesn't move either.
        ratio = 0.0 if stands else float(np.clip(_ratio_of_tips(tips), -MAX_LOG_ODDS, MAX_LOG_ODDS))
        if stands or (hovered and not tips):
            self._odds, self._undecided = _log_odds(PRIOR), True
        odds = self._odds + ratio
        probability = 1 / (1 + math.exp(-odds))
        self._arrives = stands
        length = float(np.linalg.norm(way))
        self._speed = length / self._age if probability < THRESHOLD else 0.0
        self._undecided &= probability >= THRESHOLD
        if not tips or self._age == MAX_AGE or length > MAX_WAY or (stands and self._age > 1):
            self._begin(shown, prepared)
            self._odds = odds
        else:
            self._way = way
        return probability


def _log_odds(probability: float) -> float:
    return math.log(probability / (1 - probability))


def _ratio_of_tips(tips: list[TipMotion]) -> float:
    """The logarithm of the likelihood ratio that any of the tips says which move most; the others say little."""
    way = [float(np.linalg.norm(tip.tool)) for tip in tips]
    return max((log_ratio(tip) for tip, length in zip(tips, way, strict=True) if length >= max(way) / 2), default=0.0)


def observed_motion(before: Shown, after: Shown) -> list[TipMotion]:
    """Motion of every tool's tip, the tissue next to it and the background from one picture to a later one.

    Returns:
        One a tool whose motion is known; none where the background's isn't.
    """
    # Parts of a mask with fewer pixels are no tool.
    tips = tool_tips(before.tool, before.lit, TIP, 60)
    if not tips:
        return []
    places = spread((before.away > GUARD) & before.lit, SPACING)
    places = places[textured(before.gray, places)]
    distance = values_at(before.away, places) - GUARD
    # Every point belongs to the tip that it is nearest to, or to a shaft.
    owner = _nearest(places, tips, before)
    owner[distance > RING] = -1
    near, far = np.flatnonzero(owner >= 0), np.flatnonzero(distance > RING)
    every = max(1, round(len(near) / (POINTS * len(tips))))
    chosen = np.concatenate([near[::every], far[:: max(1, round(len(far) / POINTS))]])
    places, distance, owner = places[chosen], distance[chosen], owner[chosen]
    step, known = followed(before.gray, after.gray, places)
    background = background_motion(places[known & (owner < 0)], step[known & (owner < 0)])
    if background is None:
        return []
    known &= values_at(after.away, np.rint(places + step)) > GUARD / 2
    moved = step - background.at(places)
    if np.linalg.norm(np.median(background.at(places), axis=0)) < CAMERA_STILL:
        moved[_stays(before.colour, after.colour, places, moved)] = 0.0
    motions = []
    for index, tip in enumerate(tips):
        places = tip[:: max(1, len(tip) // POINTS)]
        # Windows so small don't mix tool and tissue.
        step, found = followed(before.gray, after.gray, places, 11)
        motion = _tool_motion((step - background.at(places))[found])
        if motion is not None:
            around, errors = known & (owner == index), (background.noise, background.error)
            spacing = SPACING * math.sqrt(every)
            motions.append(TipMotion(moved[around], distance[around], spacing, *motion, *errors))
    return motions


def _stays(before: np.ndarray, after: np.ndarray, places: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """Return whether colours show that tissue which seems to move has stayed where it was, bool [N].

    Edges of an instrument's shadow go along with it and are followed, but a shadow leaves the colour of tissue. Where
    tissue moves, colours around it change by as much as their slopes along its way say.

    Args:
        before, after: colours, as in `Shown.colour`, of a camera that stands still.
        places: columns and rows, shape [N, 2].
        moved: displacements that were followed there, shape [N, 2] [px].
    """

    def mean(values: np.ndarray) -> np.ndarray:
        return values_at(cv2.blur(values, (5, 5)), places / COARSE)

    right, down = cv2.Sobel(before, -1, 1, 0, scale=0.125), cv2.Sobel(before, -1, 0, 1, scale=0.125)
    x, y = moved.T / COARSE
    slopes = x**2 * mean(right**2) + 2 * x * y * mean(right * down) + y**2 * mean(down**2)
    expected = np.minimum(slopes, 2 * (mean(before**2) - mean(before) ** 2))
    difference = after - before
    change = mean(difference**2) - mean(difference) ** 2
    noise = float(np.median(cv2.blur(difference**2, (5, 5))))
    return (change < 0.4 * expected) & (expected > 2.5 * noise)


def _nearest(places: np.ndarray, tips: list[np.ndarray], view: Shown) -> np.ndarray:
    """Index of the tip in which the tool's pixel lies that is nearest to a place, shape [N]; -1 for a shaft."""
    owner = np.full(view.tool.shape, -1)
    for index, tip in enumerate(tips):
        owner[tip[:, 1], tip[:, 0]] = index
    bare = (~view.tool).astype(np.uint8)
    label = cv2.distanceTransformWithLabels(bare, cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL)[1]
    by_label = np.full(label.max() + 1, -1)
    by_label[label[view.tool]] = owner[view.tool]
    return by_label[label[places[:, 1], places[:, 0]]]


def _tool_motion(moved: np.ndarray) -> tuple[np.ndarray, float] | None:
    """Common displacement [2] of a tip's points [N, 2] less the background's, and its spread [px]; None if unknown."""
    if len(moved) < 8:
        return None
    middle = np.median(moved, axis=0)
    for _ in range(ITERATIONS):
        off = np.linalg.norm(moved - middle, axis=1)
        middle = np.median(moved[off <= max(2 * np.median(off), LEAST_NOISE)], axis=0)
    spread = float(np.median(np.linalg.norm(moved - middle, axis=1)))
    # A tip moves as one where half of its points are within this share of their common motion, or within 1 px.
    if spread > max(0.35 * np.linalg.norm(middle), 1.0):
        return None
    return middle, spread / MEDIAN_LENGTH
