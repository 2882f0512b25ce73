"""Gripped tissue: a sheet fitted to the first half of a clip's frames, judged on the second.

The points close to the instrument are taken as given in every frame, all others are predicted. Skill is 1 - error /
motion, root mean squares over the points of a frame: 0 = as good as saying that nothing moves, 1 = exact.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from data.labels import TOOL
from data.masks.sources import MaskClasses, MaskError, chosen_kind, open_masks
from data.source.frames import Frame, open_source
from data.source.images import read_image
from data.source.layout import IMAGE_SUFFIXES, ClipLayout, InputError, list_folder
from data.tracks.background import far_points, without_background
from data.tracks.following import MARGIN, PointFollower, shrunk, tool_distance, values_at
from data.tracks.holding import held_distance
from data.tracks.parallax import camera_motion
from estimators.estimate import LEAST_SKILL, NINETY
from estimators.grip.driver import find_driver
from estimators.grip.recorder import DRIVEN
from estimators.grip.sheet_fit import (
    LEAST_FRAMES,
    RADIUS,
    GripFrame,
    NothingMoves,
    SheetFit,
    error_shares,
    fit_sheet,
    length,
    skill,
)

NEARBY = 35.0
"""Nearby points began nearer to the tool than this percentile of those that are followed [%]."""
HELD = (0.5, 0.7)
"""Without drawn masks: shares of the driver's motion above which tissue, or the instrument, may count as held."""
REHEARSED = (0.5, 0.75)
"""Shares of the first half's frames that predict its later ones, to see how far off predictions under a moving camera
are: half of them know less than what is judged does, three quarters look less far ahead."""
LEAD = 0.2
"""By so much more skill motion must tell a grip under a moving camera, whose own motion is predicted at any place."""
OPENING = 15
"""Blobs of a stored mask that no square of this side fits into are no tool [px]."""


@dataclass(frozen=True)
class PulledClip:
    """A clip and which part of it is judged."""

    frames: Path
    """Folder of pictures, or a video file."""
    masks: Path | None = None
    """Folder of masks in the pictures' order; None = those beside the frames, else the automatic ones."""
    tool_value: int = 0
    """Grey value of the tool in the masks."""
    camera: bool = False
    """Whether the camera moves, so that the background's motion is taken off."""
    start: int = 0
    """First frame, where the tissue is taken to be at rest."""
    stop: int | None = None
    """Frame behind the last one."""


@dataclass(frozen=True, eq=False)
class Follow:
    """Followed points of a clip; N points, T frames after the first."""

    points: np.ndarray
    """Places in the first frame, shape [N, 2] [px]."""
    spacing: int
    """Of their grid [px]."""
    distance: np.ndarray
    """From the tool there, shape [N] [px]."""
    frames: list[GripFrame]
    """T of them."""
    pictures: tuple[np.ndarray, np.ndarray]
    """The first and the last, RGB."""
    unreadable: list[str]
    """Sentences about frames that were left out."""
    grip: str
    """What tells where the tissue is held: `masks` or `motion`."""
    camera: bool
    """Whether the camera moves."""

    def told(self, learnt: int) -> list[GripFrame]:
        """The frames with what a moving camera does to uneven tissue, as so many of the first ones tell it."""
        if not self.camera:
            return self.frames
        moved = np.stack([frame.moved for frame in self.frames])
        carried = camera_motion(self.points, self.spacing, moved, self.distance, learnt)
        told = []
        for frame, part in zip(self.frames, carried, strict=True):
            off = (frame.moved - part)[far_points(frame.moved, self.distance)]
            told.append(dataclasses.replace(frame, carried=part, astray=length(off) if len(off) else math.inf))
        return told


@dataclass(frozen=True, eq=False)
class Pull:
    """What is said of a clip."""

    measures: dict[str, object]
    """Numbers and words by name."""
    follow: Follow
    fit: SheetFit
    skills: dict[str, np.ndarray]
    """By kind of points and sheet, a judged frame each."""
    judged: list[int]
    """Indices of the judged frames."""
    force: tuple[np.ndarray, np.ndarray]
    """Over that of the last frame, and its standard deviation, of every frame that is used."""


def evaluate_pull(clip: PulledClip) -> Pull:
    """Follow, fit and judge.

    Raises:
        InputError: the clip can't be read, or shows no tool or no tissue.
        NothingMoves: nothing could be fitted.
    """
    follow = follow_clip(clip)
    half = len(follow.frames) // 2
    told = follow.told(half)
    early, late = told[:half], [frame for frame in told[half:] if frame.tells]
    sheets = {
        "field": fit_sheet(follow.points, follow.spacing, early),
        "one number": fit_sheet(follow.points, follow.spacing, early, field=False),
    }
    if follow.camera:
        # What the camera does is learnt from the very frames that the sheet is fitted to.
        errors = [error_shares(*_rehearsed(follow, share)[1]) for share in REHEARSED]
        grip, own = np.sqrt(np.square(errors).mean(axis=0)).tolist()
        sheets = {name: dataclasses.replace(sheet, error=(grip, own)) for name, sheet in sheets.items()}
    fit = sheets["field"]
    skills: dict[str, list[float]] = {}
    held = []
    for frame in late:
        nearby = nearby_frame(frame, follow.distance)
        for kind, judged in (("all", frame), ("nearby", nearby)):
            for name, sheet in sheets.items():
                skills.setdefault(f"{kind}, {name}", []).append(skill(sheet, judged))
            if follow.camera:
                left = 1 - length(judged.own[judged.around]) / length(judged.moved[judged.around])
                skills.setdefault(f"{kind}, camera alone", []).append(left)
        moved, sd = fit.predict(frame)
        off = np.linalg.norm(moved - frame.moved, axis=1)[frame.around]
        held.append(float((off < RADIUS * sd[frame.around]).mean()))
    found = {name: np.array(values) for name, values in skills.items()}
    used = [frame for frame in follow.frames if frame.tells]
    judged = [index for index, frame in enumerate(follow.frames, start=1) if index > half and frame.tells]
    measures = _measures(follow, sheets, found, held, judged)
    return Pull(measures, follow, fit, found, judged, fit.relative_force(used))


def _measures(
    follow: Follow,
    sheets: Mapping[str, SheetFit],
    skills: Mapping[str, np.ndarray],
    held: list[float],
    judged: list[int],
) -> dict[str, object]:
    """Rows of the table."""
    fit, one = sheets["field"], sheets["one number"]
    log, sd = one.mean_log_anchor
    found: dict[str, object] = {
        "status": "ok" if judged else "nothing moves in the second half",
        "frames": len(follow.frames) + 1,
        "frames left out": len(follow.unreadable),
        "frames judged": len(judged),
        "points": len(follow.points),
        "grip told by": follow.grip,
        "foundation over stiffness": float(np.exp(log)),
        "foundation over stiffness, low": float(np.exp(log - NINETY * sd)),
        "foundation over stiffness, high": float(np.exp(log + NINETY * sd)),
        "roughness between knots": fit.roughness,
    }
    if judged:
        for name, values in skills.items():
            found[f"skill of {name}, mean"] = float(values.mean())
            found[f"skill of {name}, last frame"] = float(values[-1])
        found["points within the 90 % bands"] = float(np.mean(held))
        explained = skills["all, field"].mean() >= LEAST_SKILL
        found["verdict"] = "the sheet explains the motion" if explained else "the sheet does not explain the motion"
        if follow.camera:
            # Of the motion that the camera leaves: 1 - error / that.
            beside = {
                kind: float((1 - (1 - skills[f"{kind}, field"]) / (1 - skills[f"{kind}, camera alone"])).mean())
                for kind in ("all", "nearby")
            }
            found |= {f"skill of {kind}, beside the camera, mean": value for kind, value in beside.items()}
            if explained and beside["all"] < LEAST_SKILL:
                found["verdict"] = "the camera explains the motion, the sheet little of the rest"
    return found


def nearby_frame(frame: GripFrame, distance: np.ndarray) -> GripFrame:
    """The frame with those points around the grip alone that began close to the tool, or with all if none did."""
    around = frame.around
    nearby = around & (distance < np.percentile(distance[around | frame.gripped], NEARBY))
    shown = frame.gripped | (nearby if nearby.any() else around)
    return dataclasses.replace(frame, moved=np.where(shown[:, None], frame.moved, np.nan))


def follow_clip(clip: PulledClip) -> Follow:
    """Follow the tissue's points through a clip.

    Where nobody has drawn masks, the grip is where the automatic ones show an instrument, in the first frame or in the
    last one of the first half that shows any, or where motion tells it (`find_driver`): what predicts the later frames
    of the first half better from its earlier ones (under a moving camera motion needs a LEAD).

    Raises:
        InputError: it can't be read, has fewer than two frames, or its first frame shows no tool or no tissue.
    """
    drawn = clip.masks is not None or chosen_kind("auto", clip.frames, ClipLayout()) == "annotation"
    masked: PointFollower | None = None
    free: PointFollower | None = None
    shown, everything, unreadable = list[np.ndarray](), list[np.ndarray](), list[str]()
    aways: list[np.ndarray | None] = []
    first = picture = np.zeros((0, 0, 3), np.uint8)
    for number, current, tool in read_views(clip):
        if isinstance(tool, str) or current is None:
            unreadable.append(f"frame {number}: {tool}")
            continue
        picture, tool = shrunk(current, tool)
        if masked is None:
            first, masked = picture, PointFollower(picture, tool)
            free = None if drawn else PointFollower(picture, np.zeros_like(tool))
            if (drawn and not tool.any()) or not len(masked.points):
                what = "instrument" if drawn and not tool.any() else "tissue away from the instrument"
                raise InputError(
                    f"{clip.frames} shows no {what} where the judged part begins; choose another frame (--start)."
                )
            continue
        masked.step(picture, tool)
        shown.append(masked.moved)
        if free is not None:
            free.step(picture, np.zeros_like(tool))
            everything.append(free.moved)
            aways.append(values_at(tool_distance(tool), masked.expected) if tool.any() else None)
    if masked is None or not shown:
        raise InputError(f"{clip.frames} has fewer than two frames that can be used; give more of them.")

    def follow(follower: PointFollower, distance: np.ndarray, moved: list[np.ndarray], grip: str) -> Follow:
        """Of the points that are not held themselves."""
        used = distance > MARGIN
        points, away = follower.points[used], distance[used]
        frames = []
        for motion in (item[used] for item in moved):
            motion = without_background(points, motion, away) if clip.camera else motion
            frames.append(GripFrame(motion, np.isfinite(motion).all(axis=1) & (away < DRIVEN)))
        return Follow(points, follower.spacing, away, frames, (first, picture), unreadable, grip, clip.camera)

    found = [follow(masked, masked.distance, shown, "masks")]
    if free is not None:
        half = max(len(everything) // 2, 1)
        found += [follow(masked, away, shown, "masks") for away in aways[:half] if away is not None][-1:]
        driver = find_driver(free.points, free.spacing, everything[half - 1], clip.camera)
        if driver is not None:
            pieces = [held_distance(free.points, free.spacing, driver.own, driver.place, share) for share in HELD]
            found += [follow(free, away, everything, "motion") for away in pieces if np.isfinite(away).all()]
    if len(found) == 1:
        return found[0]
    lead = LEAD if clip.camera else 0.0
    return max(found, key=lambda one: _expected_skill(one) - (lead if one.grip == "motion" else 0.0))


def _rehearsed(follow: Follow, share: float) -> tuple[list[float], np.ndarray]:
    """Fit one number to the earlier share of the first half's frames that tell, and predict the later ones.

    Returns:
        Skill of every later frame, and of all their points what `error_shares` needs, shape [3, n] [px²].

    Raises:
        NothingMoves: nothing can be fitted.
    """
    moving = [index for index, frame in enumerate(follow.frames[: len(follow.frames) // 2]) if frame.tells]
    count = max(math.ceil(share * len(moving)), LEAST_FRAMES)
    early, late = moving[:count], moving[count:]
    frames = follow.told(early[-1] + 1 if early else 0)
    fit = fit_sheet(follow.points, follow.spacing, [frames[index] for index in early], field=False)
    skills, parts = [], []
    # One number hardly fits noise: of a short clip the same frames must do.
    for frame in (frames[index] for index in late or early):
        around, moved = frame.around, fit.predict(frame)[0]
        squares = (np.square(motion[around]).sum(axis=1) for motion in (moved - frame.moved, moved))
        parts.append(np.stack([*squares, np.full(around.sum(), frame.reach**2)]))
        skills.append(skill(fit, frame))
    return skills, np.hstack(parts)


def _expected_skill(follow: Follow) -> float:
    """Of one number in the later part of the first half, fitted to its earlier one; -∞ where too little moves."""
    try:
        return float(np.mean(_rehearsed(follow, REHEARSED[0])[0]))
    except NothingMoves:
        return -math.inf


def read_views(clip: PulledClip) -> Iterator[tuple[int, np.ndarray | None, np.ndarray | str]]:
    """Number of a frame, its RGB picture, and its mask of the tool; or no picture and why it can't be used."""
    source = open_source(clip.frames, ClipLayout())
    tools = _stored_tools(clip) if clip.masks is not None else _found_tools(clip.frames)
    for frame in islice(source, clip.stop):
        tool = tools(frame)
        if frame.index < clip.start:
            continue
        if frame.image is None or isinstance(tool, str):
            yield frame.number, None, frame.error or tool
        elif tool.shape != frame.image.shape[:2]:
            yield frame.number, None, "Its mask is of another size than its picture."
        else:
            yield frame.number, frame.image, tool


def _stored_tools(clip: PulledClip) -> Callable[[Frame], np.ndarray | str]:
    """Gives the tool of a frame from a folder of masks, bool [H, W], or why there is none."""
    folder, value = clip.masks, clip.tool_value
    if folder is None or not folder.is_dir():
        raise InputError(f"{folder} is no folder; give the one of the masks, in the pictures' order.")
    files = [path for path in list_folder(folder) if path.suffix.lower() in IMAGE_SUFFIXES]
    if not files:
        raise InputError(f"{folder} holds no masks; give a folder of pictures whose tool has the value {value}.")
    square = np.ones((OPENING, OPENING), np.uint8)

    def tool(frame: Frame) -> np.ndarray | str:
        if frame.index >= len(files):
            return f"{folder} holds {len(files)} masks, none for this frame."
        try:
            grey = read_image(files[frame.index], cv2.IMREAD_GRAYSCALE)
        except InputError as error:
            return str(error)
        return cv2.morphologyEx((grey == value).astype(np.uint8), cv2.MORPH_OPEN, square) > 0

    return tool


def _found_tools(frames: Path) -> Callable[[Frame], np.ndarray | str]:
    """The same from masks beside the frames, or else from the automatic ones."""
    masks = open_masks("auto", ClipLayout(), MaskClasses(), frames)

    def tool(frame: Frame) -> np.ndarray | str:
        if frame.image is None:
            return frame.error
        try:
            return masks(frame) == TOOL
        except MaskError as error:
            return str(error)

    return tool
