"""Synthetic clips whose tool grips tissue, or only passes over it, against their truth.

Judged are the foundation, the force, where the tissue is stiff, and whether there is contact.

The very session that users run is asked (estimator `direct`). Errors of the foundation and of the force are compared
with the Cramér–Rao bound (`evaluation.recovery.grip_bound`) of somebody who knows the sheet and how well each point is
followed in the clip, which is measured: followed minus true place (`evaluation.recovery.followed`).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import KDTree
from scipy.stats import spearmanr

from data.labels import TOOL
from data.prepared import PreparedFrame
from data.synthetic.clip import draw_truth, synthetic_clip
from data.synthetic.grip import GrippedMotion
from data.synthetic.scene import Scene, SceneError
from data.synthetic.source import open_synthetic
from data.tracks.following import SPACING, PointFollower
from estimators.contract import ClipInfo
from estimators.estimate import NINETY, FrameEstimate, GripEstimate, InteractionEstimate
from estimators.grip.stiffness_field import StiffnessField
from estimators.open import EstimatorOptions
from evaluation.recovery.estimators import opened
from evaluation.recovery.evaluate import OK, PREPARE
from evaluation.recovery.followed import measure_following
from evaluation.recovery.grip_bound import grip_bound
from evaluation.recovery.scores import coverage, rms
from evaluation.recovery.suites import GRIP_SUITES
from physics.doors import interruptible
from physics.identifiability import LIMIT

COLUMNS = ("suite", "quantity", "n", "rmse", "bound", "ratio", "coverage90", "value")
DIRECT = "direct"
"""The estimator that is asked."""
STIRRED = 1.0
"""Tool or tissue moves where either has gone so far since the frame before [px]."""
MOVED = 5.0
"""A stiffness field is judged where tissue moves by more than this [px]."""


@dataclass(frozen=True)
class GripTask:
    """What one worker does in one go."""

    suite: str
    index: int
    seed: int
    """Seed of the clip."""


@dataclass(frozen=True)
class GripRecovery:
    """Truth and estimate of one clip; what doesn't exist is not a number."""

    suite: str
    index: int
    seed: int
    status: str = OK
    """`ok`, or why nothing is known: `no scene`, `no estimate`, `error`."""
    reason: str = ""
    contact_right: float = math.nan
    """Share of the frames in which something moves whose `contact` is the true one."""
    verdict: str = ""
    skill: float = math.nan
    foundation: np.ndarray | None = None
    """Log of foundation over stiffness: true, estimated, its standard deviation and bound, shape [4]."""
    force: np.ndarray | None = None
    """The same of the force over stiffness in the last frame."""
    damping: np.ndarray | None = None
    """Log of damping over stiffness [s]: true, and its bound, shape [2]; nothing estimates it."""
    curve: np.ndarray | None = None
    """Force over that of the last frame: true, estimated, and its standard deviation, shape [3, T]."""
    following: float = math.nan
    """Error of a followed point by axis in the last frame, root mean square [px]."""
    rank: float = math.nan
    """Rank correlation of the stiffness field with the true one where tissue moves."""
    rank_most: float = math.nan
    """That of regions told apart exactly, in any order within each: √(3p(1 - p)) if a share p lies in one of two."""
    held: float = math.nan
    """Share of the field's knots there whose 90 % interval holds the true stiffness."""
    held_between: float = math.nan
    """The same of all followed points there: bilinear between knots 32 px apart, a step is none."""
    knots: float = math.nan
    """How many knots lie there."""

    @property
    def key(self) -> tuple[str, int, str]:
        """What tells it from other results of a run."""
        return self.suite, self.index, DIRECT


def evaluate_grip(task: GripTask) -> list[GripRecovery]:
    """Result of one clip; what goes wrong becomes a result that says so."""
    settings = GRIP_SUITES[task.suite].settings
    empty = GripRecovery(task.suite, task.index, task.seed)
    try:
        scene, motion = draw_truth(settings, task.seed)
    except SceneError as error:
        return [dataclasses.replace(empty, status="no scene", reason=str(error))]
    try:
        if not isinstance(motion, GrippedMotion):
            raise TypeError(f"{task.suite} draws presses.")
        with interruptible():
            clip = open_synthetic(synthetic_clip(scene, motion, task.seed), PREPARE)
            frames, info = list(clip), ClipInfo.of(clip)
            session = opened(EstimatorOptions(DIRECT, threads=1)).start(info)
            said = [item for frame in frames for item in session.push(frame)] + list(session.finish())
            found = [item for item in said if isinstance(item, InteractionEstimate)]
            contact = [item.contact is True for item in said if isinstance(item, FrameEstimate)]
            moves = moving_frames(scene, motion)
            right = float((np.array(contact) == motion.in_contact)[moves].mean()) if moves.any() else math.nan
            run = next((item for item in found if item.grip is not None), None)
            known = dataclasses.replace(empty, contact_right=right)
            if run is None or run.grip is None:
                return [
                    dataclasses.replace(known, status="no estimate", reason=" ".join(item.detail for item in found))
                ]
            known = dataclasses.replace(known, verdict=run.verdict, skill=run.grip.skill)
            if run.onset < motion.onset_frame:
                return [known]
            return [dataclasses.replace(known, **_compared(run.onset, run.grip, scene, motion, frames))]
    except Exception as error:  # a clip that breaks something is a result, and the others go on
        return [dataclasses.replace(empty, status="error", reason=f"{type(error).__name__}: {error}")]


def moving_frames(scene: Scene, motion: GrippedMotion) -> np.ndarray:
    """Frames in which the tool or the tissue it holds moves, shape [F], bool: in others nothing tells of contact."""
    camera, vertex = scene.camera, scene.mesh.vertices[scene.vertex]
    held = vertex[:2] + motion.contact[:, :2]
    place = held / (vertex[2] + motion.contact[:, 2:]) * [camera.fx, camera.fy]
    tip = place + motion.course * scene.settings.cell
    steps = np.maximum(*(np.linalg.norm(np.diff(way, axis=0), axis=1) for way in (place, tip)))
    return np.append(False, steps > STIRRED)


def _compared(
    onset: int, grip: GripEstimate, scene: Scene, motion: GrippedMotion, frames: Sequence[PreparedFrame]
) -> dict[str, object]:
    """Fields of a `GripRecovery`: truth, estimate and bound of a run of contact that begins in a frame."""
    cell = np.array(scene.settings.cell)
    used = onset + np.rint(grip.times * scene.settings.fps).astype(int)
    follower, moved, told = _followed(frames[onset : used[-1] + 1])
    points = follower.points.astype(np.float64)
    true_moved = np.array([picture_motion(scene, motion, index, points) for index in (onset, *used)])
    true = true_moved[1:] - true_moved[0]
    error = moved[used - onset - 1] - true
    seen = np.isfinite(error[-1]).all(axis=1)
    size = float(np.sqrt(np.square(error[-1, seen]).mean()))
    places = points[seen], follower.distance[seen]
    following = measure_following(*places, SPACING, told[seen], error[:, seen])
    log_anchor = math.log(motion.anchor * SPACING**2 / cell.prod())
    relaxation = motion.damping / motion.anchor
    bound = grip_bound(*places, follower.hidden, SPACING, grip.times, true[:, seen], following, log_anchor, relaxation)
    log, sd = log_interval(
        grip.foundation_over_stiffness, grip.foundation_over_stiffness_low, grip.foundation_over_stiffness_high
    )
    force = motion.reaction[used] / scene.spacing * cell
    unit = force[-1] / (force[-1] @ force[-1])
    pull = log_interval(
        grip.reaction_over_stiffness, grip.reaction_over_stiffness_low, grip.reaction_over_stiffness_high
    )
    found: dict[str, object] = {
        "foundation": np.array([log_anchor, log, sd, bound.foundation]),
        "force": np.array([math.log(np.linalg.norm(force[-1])), *pull, bound.force]),
        "damping": np.array([log_anchor + math.log(relaxation), bound.damping]),
        "curve": np.array([force @ unit, grip.force, grip.force_sd]),
        "following": size,
    }
    if scene.settings.regions > 1 and grip.stiffness is not None:
        found |= _field(grip.stiffness, points, true[-1], scene, motion)
    return found


def log_interval(value: float, low: float, high: float) -> tuple[float, float]:
    """Logarithm and its standard deviation, of a value and the ends of its 90 % interval."""
    return math.log(value), math.log(high / low) / (2 * NINETY)


def picture_motion(scene: Scene, motion: GrippedMotion, frame: int, points: np.ndarray) -> np.ndarray:
    """True displacement in the picture of tissue points [N, 2] (column, row at rest) in a frame, shape [N, 2] [px]."""
    rest = scene.mesh.vertices.astype(np.float64)
    moved, camera = rest + motion.field[frame], scene.camera
    shift = [camera.fx, camera.fy] * (moved[:, :2] / moved[:, 2:] - rest[:, :2] / rest[:, 2:])
    grid = np.zeros((*scene.mesh.grid_shape, 2))
    grid[tuple(scene.mesh.pixels.T)] = shift
    place = (points[:, ::-1] + 0.5) / np.array(scene.settings.cell)[::-1] - 0.5
    return np.stack([map_coordinates(grid[..., axis], place.T, order=1, mode="nearest") for axis in (0, 1)], axis=1)


def _followed(frames: Sequence[PreparedFrame]) -> tuple[PointFollower, np.ndarray, np.ndarray]:
    """Points followed through frames as the estimator follows them.

    Returns:
        The follower, displacements since the first frame in those after it [F - 1, N, 2] and the noise told of the last
        ones [N] [px].
    """
    first, *others = [(frame.view[0], frame.view[1] == TOOL) for frame in frames]
    follower, moved = PointFollower(*first), []
    for picture, tool in others:
        follower.step(picture, tool)
        moved.append(follower.moved)
    return follower, np.array(moved), follower.noise


def _field(
    found: StiffnessField, points: np.ndarray, true: np.ndarray, scene: Scene, motion: GrippedMotion
) -> dict[str, float]:
    """How a fitted stiffness field compares with the true one where tissue moves, at its knots and at points [N]."""
    moves = np.linalg.norm(true, axis=1) > MOVED
    apart, nearest = KDTree(points).query(found.knots)
    at_knots = found.knots[moves[nearest] & (apart < SPACING)]

    def off(places: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        log, sd = found.at(places)
        truth, middle = _true_log(places, scene, motion), _true_log(found.moving, scene, motion).mean()
        held = np.abs(log - truth + middle) < NINETY * sd
        return log, truth, float(held.mean()) if len(places) else math.nan

    log, truth, held_between = off(points[moves])
    stiffer = float((truth > (motion.log_stiffness.max() + motion.log_stiffness.min()) / 2).mean())
    return {
        "rank": float(spearmanr(log, truth).statistic),
        "rank_most": math.sqrt(3 * stiffer * (1 - stiffer)),
        "held": off(at_knots)[2],
        "held_between": held_between,
        "knots": len(at_knots),
    }


def _true_log(places: np.ndarray, scene: Scene, motion: GrippedMotion) -> np.ndarray:
    """True log stiffness at places [N, 2] (column, row) [px], shape [N]."""
    cells = (places[:, ::-1] + 0.5) / np.array(scene.settings.cell)[::-1] - 0.5
    return map_coordinates(motion.log_stiffness, cells.T, order=1, mode="nearest")


def grip_rows(rows: Sequence[GripRecovery]) -> list[dict[str, object]]:
    """Rows of `grips.csv`: one a suite and quantity, errors of logarithms but for the force's curve."""
    found: list[dict[str, object]] = []
    for suite in dict.fromkeys(row.suite for row in rows):
        clips = [row for row in rows if row.suite == suite]
        found += [{"suite": suite, **cells} for cells in _suite_rows(clips)]
    return found


def _suite_rows(clips: Sequence[GripRecovery]) -> Iterator[dict[str, object]]:
    for name in ("foundation", "force"):
        told = [getattr(row, name) for row in clips if getattr(row, name) is not None]
        if told:
            true, log, sd, bound = np.array(told).T
            error, least = rms(log - true), rms(bound)
            cells = {"rmse": error, "bound": least, "ratio": error / least, "coverage90": coverage(log - true, sd)}
            yield {"quantity": f"{name} over stiffness", "n": len(told), **cells}
    damped = [row.damping for row in clips if row.damping is not None]
    if damped:
        bounds = np.array(damped)[:, 1]
        # Of a clip that tells nothing the bound may be as large as it likes.
        yield {
            "quantity": "damping over stiffness, bound of the median clip",
            "n": len(bounds),
            "bound": np.median(bounds),
        }
        known = float((bounds < LIMIT).mean())
        yield {"quantity": "clips that could tell damping over stiffness", "n": len(bounds), "value": known}
    curves = [row.curve for row in clips if row.curve is not None]
    if curves:
        # The last frame's ratio is 1 by definition.
        true, value, sd = np.concatenate([curve[:, :-1] for curve in curves], axis=1)
        known = np.isfinite(value)
        off, sd = (value - true)[known], sd[known]
        yield {"quantity": "relative force", "n": len(off), "rmse": rms(off), "coverage90": coverage(off, sd)}
    for name, text in (
        ("skill", "skill, mean"),
        ("contact_right", "moving frames whose contact is right"),
        ("following", "error of following in the last frame, RMS [px]"),
        ("rank", "rank correlation of the stiffness field, mean"),
        ("rank_most", "that of regions told apart exactly, in any order within each"),
        ("held_between", "points of the stiffness field within the 90 % intervals"),
    ):
        values = [value for value in (getattr(row, name) for row in clips) if math.isfinite(value)]
        if values:
            yield {"quantity": text, "n": len(values), "value": float(np.mean(values))}
    fields = [row for row in clips if row.knots > 0]
    if fields:
        held, count = (np.array([getattr(row, name) for row in fields]) for name in ("held", "knots"))
        share = float(held @ count / count.sum())
        yield {"quantity": "knots of the stiffness field within the 90 % intervals", "n": count.sum(), "value": share}
    determined = sum(row.verdict == "foundation" for row in clips)
    yield {"quantity": "clips whose foundation is determined", "n": len(clips), "value": determined / len(clips)}
