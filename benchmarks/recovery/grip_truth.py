"""Estimates of a grip compared with the truth; `trial` explains the rows' names."""

import math

import numpy as np

from benchmarks.harness import Row
from palpate.data.synthetic.grip import GrippedMotion
from palpate.data.synthetic.scene import Scene
from palpate.estimators.grip.grip_estimate import GripEstimate
from palpate.estimators.records import FrameEstimate, InteractionEstimate

STIRRED = 1.0
"""Tool or tissue moves where either has gone so far since the frame before [px]."""


def gripped(scene: Scene, motion: GrippedMotion, answer: list) -> Row:
    """Compare a grip with the truth."""
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
    # In pixels, which needn't be square.
    reaction = motion.reaction * np.array(scene.settings.cell)
    return found | {"curve": force_curve(run.onset, grip, reaction, scene.settings.fps)}


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


def force_curve(onset: int, grip: GripEstimate, reaction: np.ndarray, fps: float) -> np.ndarray:
    """Force over that of the last frame: true, estimated, its standard deviation, shape [3, T].

    Args:
        onset: index of the run's first frame.
        grip: the estimate.
        reaction: true force in every frame, shape [F, A], in any unit.
        fps: frames a second.
    """
    force = reaction[onset + np.rint(grip.times * fps).astype(int)]
    return np.array([force @ force[-1] / (force[-1] @ force[-1]), grip.force, grip.force_sd])
