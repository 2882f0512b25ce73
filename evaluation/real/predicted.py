"""Gripped tissue predicted some frames ahead: the online estimator and a sheet of one number.

Both see the frames up to one, and of the later ones the tissue at the instrument alone. Skill is 1 - error / motion
since that frame, root mean squares over the points that are followed in both and that the instrument doesn't hold:
0 = as good as saying that nothing moves on, 1 = exact.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from palpate.data.clip import ClipStream
from palpate.data.labels import TOOL, MaskError
from palpate.data.masks.sources import MaskClasses, open_masks
from palpate.data.source.frames import open_source
from palpate.data.source.layout import InputError
from palpate.data.tracks.following import MARGIN, PointFollower, shrunk
from palpate.estimators.contract import Chosen
from palpate.estimators.estimate import NoEstimate
from palpate.estimators.grip.lattice import LEAST_MOTION, GripFrame, NothingMoves, lattice_springs, length
from palpate.estimators.grip.recorder import DRIVEN
from palpate.estimators.online.driven import DrivenTissue
from palpate.estimators.online.estimator import OnlineEstimator
from palpate.estimators.online.settings import OnlineSettings
from palpate.estimators.online.surface import Surface, make_surface
from palpate.evaluation.harness import Row
from palpate.evaluation.real.pulled import PulledClip
from palpate.physics.sheet import equilibrium

FROM, AHEAD = (3, 4, 5), 10
"""Predicted is from these frames after the first, so many frames on (Liang 2024, section III: its horizon)."""
RATIOS = np.geomspace(1e-4, 1, 17)
"""Of foundation to springs that a sheet of one number is tried with."""
LEAST_POINTS = 20
"""Fewer points that are followed in both frames judge nothing."""
NEARBY = 35.0
"""Nearby points began nearer to the tool than this percentile of those that are followed [%]."""


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


def evaluate_prediction(clip: PulledClip, settings: OnlineSettings) -> Row:
    """Follow, step on frame by frame, predict, and judge: what is measured, by name.

    Raises:
        InputError: the clip can't be read, is too short, or shows no tool or no tissue with depth.
        NothingMoves: no sheet can be fitted to the frames that both see.
    """
    follow = follow_clip(clip)
    if len(follow.frames) < min(FROM) + AHEAD:
        raise InputError(f"{clip.path} has fewer than {min(FROM) + AHEAD + 1} usable frames; give more of them.")
    surface = first_surface(clip, settings)
    measures: Row = {"status": "ok", "estimator": "online", "particles": surface.body.count}
    skills: dict[str, list[float]] = {"online": [], "sheet": [], "sheet from rest": []}
    tissue = DrivenTissue(surface, follow.points, follow.distance, settings)
    for index in FROM:
        if index + AHEAD > len(follow.frames):
            continue
        # Anew each time: what is fitted may see the frames up to this one.
        fitted = replace(settings, fitted=min(settings.fitted, index))
        tissue = DrivenTissue(surface, follow.points, follow.distance, fitted)
        for frame in follow.frames[:index]:
            tissue.step(frame.moved)
        frame = follow.frames[index - 1]
        later = follow.frames[index : index + AHEAD]
        around, now, then = tissue.around, frame.moved, later[-1].moved
        used = _judged(around, frame, later[-1])
        chosen = around[used]
        if len(chosen) < LEAST_POINTS:
            measures[f"points from frame {index}"] = len(chosen)
            continue
        since = then[chosen] - now[chosen]
        held = tissue.shown(tissue.session.positions[None])[0]
        ahead = tissue.ahead(np.stack([item.moved for item in later]))[-1]
        ratio = sheet_ratio(follow, follow.frames[:index])
        resting, pulled = (sheet_motion(follow, each, ratio)[chosen] for each in (frame, later[-1]))
        found = {
            "online": (ahead - held)[used],
            "sheet": pulled - resting,
            # Its displacement from rest as it is, less what is observed by now.
            "sheet from rest": pulled - now[chosen],
        }
        measures[f"points from frame {index}"] = len(chosen)
        measures[f"motion since frame {index} [px]"] = length(since)
        measures[f"foundation over stiffness by frame {index}"] = ratio
        if tissue.fit is not None:
            measures |= {f"fitted {name} by frame {index}": value for name, value in tissue.fit._asdict().items()}
        for name, motion in found.items():
            skills[name].append(skill(motion, since))
            measures[f"skill from frame {index}, {name}"] = skills[name][-1]
    if not skills["online"]:
        raise InputError(f"{clip.path}: fewer than {LEAST_POINTS} points are followed {AHEAD} frames on.")
    measures |= {f"skill of {name}, mean": float(np.mean(values)) for name, values in skills.items()}
    return measures | {"known particles": float(tissue.known.mean())}


def skill(expected: np.ndarray, moved: np.ndarray) -> float:
    """1 - error / motion of expected displacements of points that moved so [Q, 2]."""
    return 1 - length(expected - moved) / length(moved)


def sheet_ratio(follow: Follow, frames: Sequence[GripFrame]) -> float:
    """Foundation over spring stiffness, of RATIOS, with which a sheet explains some frames best near the tool.

    Least mean of error over motion of the nearest third of the points, in frames where these move:
    docs/reports/real.md.

    Raises:
        NothingMoves: they do in none.
    """
    shown = [(frame, nearby_frame(frame, follow.distance)) for frame in frames]
    shown = [(frame, near) for frame, near in shown if near.gripped.any() and _moves(near)]
    if not shown:
        raise NothingMoves(f"In none of {len(frames)} frames the tissue near the tool moves by {LEAST_MOTION:g} px.")

    def off(ratio: float) -> float:
        errors = [
            length((sheet_motion(follow, frame, ratio) - frame.moved)[near.around]) / length(frame.moved[near.around])
            for frame, near in shown
        ]
        return float(np.mean(errors))

    return float(min(RATIOS, key=off))


def _moves(frame: GripFrame) -> bool:
    return bool(frame.around.any()) and length(frame.moved[frame.around]) > LEAST_MOTION


def sheet_motion(follow: Follow, frame: GripFrame, ratio: float) -> np.ndarray:
    """Displacement [P, 2] [px] of a sheet of one number whose gripped points move as in a frame.

    It is made of the points that are in view; elsewhere not a number.
    """
    visible = np.isfinite(frame.moved).all(axis=1)
    springs = lattice_springs(follow.points[visible].astype(int), follow.spacing)
    gripped, count = frame.gripped[visible], int(visible.sum())
    found = np.full(frame.moved.shape, np.nan)
    alike = np.ones(len(springs)), np.full(count, ratio)
    found[visible] = equilibrium(springs, *alike, gripped, frame.moved[frame.gripped]).displacement
    return found


def _judged(around: np.ndarray, now: GripFrame, then: GripFrame) -> np.ndarray:
    """Which of some points [Q] are in view in two frames and gripped in neither, shape [Q], bool."""
    return (now.around & then.around)[around]


def nearby_frame(frame: GripFrame, distance: np.ndarray) -> GripFrame:
    """The frame with those points around the grip alone that began close to the tool, or with all if none did."""
    around = frame.around
    nearby = around & (distance < np.percentile(distance[around | frame.gripped], NEARBY))
    shown = frame.gripped | (nearby if nearby.any() else around)
    return replace(frame, moved=np.where(shown[:, None], frame.moved, np.nan))


def follow_clip(clip: PulledClip) -> Follow:
    """Follow the tissue's points through a clip, from its first frame on in which a mask shows an instrument.

    Raises:
        InputError: it can't be read, or no two frames can be used.
    """
    follower: PointFollower | None = None
    moved = list[np.ndarray]()
    for current, tool in read_views(clip):
        picture, tool = shrunk(current, tool)
        if follower is None and tool.any():
            follower = PointFollower(picture, tool)
        elif follower is not None:
            follower.step(picture, tool)
            moved.append(follower.moved)
    if follower is None or not moved:
        raise InputError(f"{clip.path} has fewer than two frames with an instrument; give more of them.")
    used = follower.distance > MARGIN
    away = follower.distance[used]
    frames = [GripFrame(item[used], np.isfinite(item[used]).all(axis=1) & (away < DRIVEN)) for item in moved]
    return Follow(follower.points[used], follower.spacing, away, frames)


def read_views(clip: PulledClip) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """RGB pictures with their masks of the tool, bool [H, W]; frames without either are left out.

    Raises:
        InputError: the clip can't be read.
    """
    source, masks = open_source(clip.path, clip.layout), open_masks("auto", clip.layout, MaskClasses(), clip.path)
    for frame in source:
        if frame.image is None:
            continue
        try:
            yield frame.image, masks(frame) == TOOL
        except MaskError:
            continue


def first_surface(clip: PulledClip, settings: OnlineSettings) -> Surface:
    """The sheet of the first frame that shows an instrument, prepared as the estimator's are.

    Raises:
        InputError: no such frame, no depth, or no tissue with depth next to the tool.
    """
    estimator = OnlineEstimator(settings)
    stream = ClipStream(open_source(clip.path, clip.layout), estimator.preparation(Chosen(clip.layout)))
    for current in stream.source:
        frame = stream.prepared(current)
        if frame.picture_labels is None or not (frame.picture_labels == TOOL).any():
            continue
        try:
            meshed = settings.particles, settings.thickness
            return make_surface(frame, stream.picture_camera, stream.settings.geometry, *meshed)
        except NoEstimate as error:
            raise InputError(f"{clip.path}: {frame.detail or error}") from error
    raise InputError(f"{clip.path} has no frame with an instrument; give others.")
