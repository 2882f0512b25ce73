"""Gripped tissue predicted some frames ahead: the online estimator and a sheet of one number.

Both see the frames up to one, and of the later ones the tissue at the instrument alone. Skill is 1 - error / motion
since that frame, root mean squares over the points that are followed in both and that the instrument doesn't hold:
0 = as good as saying that nothing moves on, 1 = exact.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.harness import Row
from benchmarks.real.pulled import PulledClip
from palpate.api import open_clip
from palpate.data.labels import TOOL, MaskError
from palpate.data.masks.sources import MaskClasses, open_masks
from palpate.data.source.frames import open_source
from palpate.data.source.layout import InputError
from palpate.data.tracks.following import MARGIN, PointFollower, shrunk
from palpate.estimators.estimate import NoEstimate
from palpate.estimators.grip.lattice import GripFrame, length
from palpate.estimators.grip.recorder import DRIVEN
from palpate.estimators.online.driven import DrivenTissue
from palpate.estimators.online.estimator import OnlineEstimator
from palpate.estimators.online.forecast import Lattice
from palpate.estimators.online.settings import OnlineSettings
from palpate.estimators.online.surface import Surface, make_surface

FROM, AHEAD = (3, 4, 5), 10
"""Predicted is from these frames after the first, so many frames on (Liang 2024, section III: its horizon)."""
LEAST_POINTS = 20
"""Fewer points that are followed in both frames judge nothing."""


def evaluate_prediction(clip: PulledClip, settings: OnlineSettings) -> Row:
    """Follow, step on frame by frame, predict, and judge: what is measured, by name.

    Raises:
        InputError: the clip can't be read, is too short, or shows no tool or no tissue with depth.
        NothingMoves: no sheet can be fitted to the frames that both see.
    """
    lattice, frames = follow_clip(clip)
    if len(frames) < min(FROM) + AHEAD:
        raise InputError(f"{clip.path} has fewer than {min(FROM) + AHEAD + 1} usable frames; give more of them.")
    surface = first_surface(clip, settings)
    measures: Row = {"status": "ok", "estimator": "online", "particles": surface.body.count}
    skills: dict[str, list[float]] = {"online": [], "sheet": [], "sheet from rest": []}
    for index in FROM:
        if index + AHEAD > len(frames):
            continue
        # Anew each time: what is fitted may see the frames up to this one.
        fitted = replace(settings, fitted=min(settings.fitted, index))
        tissue = DrivenTissue(surface, lattice.points, lattice.distance, fitted, lattice.spacing)
        for frame in frames[:index]:
            tissue.step(frame.moved)
        frame = frames[index - 1]
        later = frames[index : index + AHEAD]
        around, now, then = tissue.around, frame.moved, later[-1].moved
        used = (frame.around & later[-1].around)[around]  # in view in both frames and gripped in neither
        chosen = around[used]
        measures[f"points from frame {index}"] = len(chosen)
        if len(chosen) < LEAST_POINTS:
            continue
        since = then[chosen] - now[chosen]
        ahead = tissue.ahead(np.stack([item.moved for item in later]))
        ratio = lattice.ratio(frames[:index])
        resting, pulled = (lattice.motion(each, ratio)[chosen] for each in (frame, later[-1]))
        found = {
            "online": ahead.since[-1][used],
            "sheet": pulled - resting,
            # Its displacement from rest as it is, less what is observed by now.
            "sheet from rest": pulled - now[chosen],
        }
        measures[f"motion since frame {index} [px]"] = length(since)
        measures[f"foundation over stiffness by frame {index}"] = ratio
        measures[f"model from frame {index}"] = ahead.model
        if tissue.fit is not None:
            measures |= {f"fitted {name} by frame {index}": value for name, value in tissue.fit._asdict().items()}
        for name, motion in found.items():
            skills[name].append(skill(motion, since))
            measures[f"skill from frame {index}, {name}"] = skills[name][-1]
    if not skills["online"]:
        raise InputError(f"{clip.path}: fewer than {LEAST_POINTS} points are followed {AHEAD} frames on.")
    measures |= {f"skill of {name}, mean": float(np.mean(values)) for name, values in skills.items()}
    return measures | {"known particles": float(tissue.determined()[1][0].mean())}


def skill(expected: np.ndarray, moved: np.ndarray) -> float:
    """1 - error / motion of expected displacements of points that moved so [Q, 2]."""
    return 1 - length(expected - moved) / length(moved)


def follow_clip(clip: PulledClip) -> tuple[Lattice, list[GripFrame]]:
    """Follow the tissue's points through a clip, from its first frame on in which a mask shows an instrument.

    Returns:
        The points, and where they are in the frames after the first.

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
    return Lattice(follower.points[used], follower.spacing, away), frames


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
    stream = open_clip(clip.path, OnlineEstimator(settings), layout=clip.layout_file)
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
