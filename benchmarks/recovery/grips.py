"""Estimates of grips against the truth, and their table: error and coverage of the relative force, skill, contact.

`trial` explains the rows' names.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.harness import Row
from benchmarks.recovery.scores import coverage, rms
from palpate.data.synthetic.grip import GrippedMotion
from palpate.data.synthetic.scene import Scene, project
from palpate.estimators.grip.grip_estimate import PullResult
from palpate.estimators.records import FrameEstimate, InteractionEstimate


def gripped(scene: Scene, motion: GrippedMotion, answer: list) -> Row:
    """Compare a grip with the truth."""
    contact = np.array([item.contact is True for item in answer if isinstance(item, FrameEstimate)])
    moves = moving_frames(scene, motion)
    found: Row = {"contact_right": float((contact == motion.in_contact)[moves].mean()) if moves.any() else np.nan}
    runs = [item for item in answer if isinstance(item, InteractionEstimate)]
    run = next((item for item in runs if item.grip is not None), None)
    if run is None or run.grip is None:
        return found | {"status": "no estimate", "reason": " ".join(item.detail for item in runs)}
    grip = run.grip
    found |= {"verdict": run.verdict, "skill": grip.skill}
    if run.onset < motion.onset_frame:
        return found
    # In pixels, which needn't be square.
    reaction = motion.reaction * np.array(scene.settings.cell)
    return found | {"curve": force_curve(run.onset, grip, reaction, scene.settings.fps)}


def moving_frames(scene: Scene, motion: GrippedMotion) -> np.ndarray:
    """Mask of frames in which the tool or the held tissue moves, shape [F]; the others don't show contact."""
    camera, vertex = scene.camera, scene.mesh.vertices[scene.vertex]
    held = vertex[:2] + motion.contact[:, :2]
    place = held / (vertex[2] + motion.contact[:, 2:]) * [camera.fx, camera.fy]
    tip = place + motion.course * scene.settings.cell
    if motion.passage is not None:
        tip = project(motion.passage.tip, camera)
    steps = np.maximum(*(np.linalg.norm(np.diff(way, axis=0), axis=1) for way in (place, tip)))
    return np.append(False, steps > 1.0)  # px


def force_curve(onset: int, grip: PullResult, reaction: np.ndarray, fps: float) -> np.ndarray:
    """Force over that of the last frame: true, estimated, its standard deviation, shape [3, T].

    Args:
        onset: index of the run's first frame.
        grip: the estimate.
        reaction: true force in every frame, shape [F, A], in any unit.
        fps: frames a second.
    """
    force = reaction[onset + np.rint(grip.times * fps).astype(int)]
    return np.array([force @ force[-1] / (force[-1] @ force[-1]), grip.force, grip.force_sd])


def grip_table(rows: Sequence[Row]) -> pd.DataFrame:
    """`grips.csv`: a row a suite and quantity, errors of the force over that of the last frame."""
    suites = dict.fromkeys(row["suite"] for row in rows)
    found = [{"suite": suite} | cells for suite in suites for cells in _quantities(rows, suite)]
    return pd.DataFrame(found, columns=("suite", "quantity", "n", "rmse", "coverage90", "value"))


def _quantities(rows: Sequence[Row], suite: str) -> Iterator[Row]:
    clips = [row for row in rows if row["suite"] == suite]

    def of(name: str) -> list[Any]:
        return [row[name] for row in clips if name in row]

    if of("curve"):
        off, sd = curve_errors(of("curve"))
        yield {"quantity": "relative force", "n": len(off), "rmse": rms(off), "coverage90": coverage(off, sd)}
    for name, text in {"skill": "skill, mean", "contact_right": "moving frames whose contact is right"}.items():
        if of(name):
            yield {"quantity": text, "n": len(of(name)), "value": float(np.mean(of(name)))}
    determined = of("verdict").count("relative_force")
    yield {"quantity": "clips whose relative force is determined", "n": len(clips), "value": determined / len(clips)}


def curve_errors(curves: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Known errors of forces over that of the last frame, and their standard deviations, shape [n]."""
    # The last frame's ratio is 1 by definition.
    true, value, sd = np.concatenate([curve[:, :-1] for curve in curves], axis=1)
    known = np.isfinite(value)
    return (value - true)[known], sd[known]
