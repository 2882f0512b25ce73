"""What is estimated of a grip, compared with the truth; the rows' names are explained in `trial`."""

import math
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import KDTree
from scipy.stats import spearmanr

from palpate.data.labels import TOOL
from palpate.data.prepared import PreparedFrame
from palpate.data.synthetic.grip import GrippedMotion
from palpate.data.synthetic.scene import Scene
from palpate.data.tracks.following import SPACING, PointFollower
from palpate.estimators.estimate import NINETY
from palpate.estimators.grip.grip_estimate import GripEstimate
from palpate.estimators.grip.stiffness_fit import StiffnessField
from palpate.estimators.records import FrameEstimate, InteractionEstimate
from palpate.evaluation.harness import Row

STIRRED = 1.0
"""Tool or tissue moves where either has gone so far since the frame before [px]."""
MOVED = 5.0
"""A stiffness field is judged where tissue moves by more than this [px]."""


def gripped(frames: Sequence[PreparedFrame], scene: Scene, motion: GrippedMotion, answer: list) -> Row:
    """What is estimated of a grip."""
    contact = np.array([item.contact is True for item in answer if isinstance(item, FrameEstimate)])
    moves = moving_frames(scene, motion)
    found: Row = {"contact_right": float((contact == motion.in_contact)[moves].mean()) if moves.any() else math.nan}
    said = _grip_of(answer)
    if isinstance(said, dict):
        return found | said
    run, grip = said
    found |= {"verdict": run.verdict, "skill": grip.skill}
    if run.onset < motion.onset_frame:
        return found
    return found | _grip_against_truth(run.onset, grip, scene, motion, frames)


def _grip_of(answer: list) -> tuple[InteractionEstimate, GripEstimate] | Row:
    """The first run of contact that has an estimate as a grip, with that, or a row that says why there is none."""
    runs = [item for item in answer if isinstance(item, InteractionEstimate)]
    missing: Row = {"status": "no estimate", "reason": " ".join(item.detail for item in runs)}
    return next(((item, item.grip) for item in runs if item.grip is not None), missing)


def moving_frames(scene: Scene, motion: GrippedMotion) -> np.ndarray:
    """Frames in which the tool or the tissue it holds moves, shape [F], bool: in others nothing shows contact."""
    camera, vertex = scene.camera, scene.mesh.vertices[scene.vertex]
    held = vertex[:2] + motion.contact[:, :2]
    place = held / (vertex[2] + motion.contact[:, 2:]) * [camera.fx, camera.fy]
    tip = place + motion.course * scene.settings.cell
    steps = np.maximum(*(np.linalg.norm(np.diff(way, axis=0), axis=1) for way in (place, tip)))
    return np.append(False, steps > STIRRED)


def _grip_against_truth(
    onset: int, grip: GripEstimate, scene: Scene, motion: GrippedMotion, frames: Sequence[PreparedFrame]
) -> Row:
    """Truth and estimate of a run of contact that begins in a frame."""
    cell = np.array(scene.settings.cell)
    used = onset + np.rint(grip.times * scene.settings.fps).astype(int)
    log_anchor = math.log(motion.anchor * SPACING**2 / cell.prod())
    force = motion.reaction[used] / scene.spacing * cell
    unit = force[-1] / (force[-1] @ force[-1])
    found: Row = {
        "foundation": np.array([log_anchor, *log_of(grip, "foundation_over_stiffness")]),
        "force": np.array([math.log(np.linalg.norm(force[-1])), *log_of(grip, "reaction_over_stiffness")]),
        "curve": np.array([force @ unit, grip.force, grip.force_sd]),
    }
    if scene.settings.regions > 1 and grip.stiffness is not None:
        picture, labels = frames[onset].view
        points = PointFollower(picture, labels == TOOL).points.astype(np.float64)
        before, after = (picture_motion(scene, motion, index, points) for index in (onset, used[-1]))
        found |= compare_fields(grip.stiffness, points, after - before, scene, motion)
    return found


def log_of(grip: GripEstimate, name: str) -> tuple[float, float]:
    """Logarithm of a quantity of a grip and its standard deviation, by the ends of its 90 % interval."""
    value, low, high = (getattr(grip, name + end) for end in ("", "_low", "_high"))
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


def compare_fields(
    found: StiffnessField, points: np.ndarray, true: np.ndarray, scene: Scene, motion: GrippedMotion
) -> dict[str, float]:
    """How a fitted stiffness field compares with the true one where tissue moves, at its knots and at points [N]."""
    moves = np.linalg.norm(true, axis=1) > MOVED
    apart, nearest = KDTree(points).query(found.knots)
    at_knots = found.knots[moves[nearest] & (apart < SPACING)]

    def off(places: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        log, sd = found.at(places)
        truth, middle = true_log(places, scene, motion), true_log(found.moving, scene, motion).mean()
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


def true_log(places: np.ndarray, scene: Scene, motion: GrippedMotion) -> np.ndarray:
    """True log stiffness at places [N, 2] (column, row) [px], shape [N]."""
    cells = (places[:, ::-1] + 0.5) / np.array(scene.settings.cell)[::-1] - 0.5
    return map_coordinates(motion.log_stiffness, cells.T, order=1, mode="nearest")
