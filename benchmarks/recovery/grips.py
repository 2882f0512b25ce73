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
    # True force in any unit, over that of the last frame; pixels needn't be square.
    reaction = motion.reaction * np.array(scene.settings.cell)
    force = reaction[run.onset + np.rint(grip.times * scene.settings.fps).astype(int)]
    true = force @ force[-1] / (force[-1] @ force[-1])
    return found | {"curve": np.array([true, grip.force, grip.force_sd])}


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
        # The last frame's ratio is 1 by definition.
        true, value, sd = np.concatenate([curve[:, :-1] for curve in of("curve")], axis=1)
        known = np.isfinite(value)
        off, sd = (value - true)[known], sd[known]
        yield {"quantity": "relative force", "n": len(off), "rmse": rms(off), "coverage90": coverage(off, sd)}
    for name, text in {"skill": "skill, mean", "contact_right": "moving frames whose contact is right"}.items():
        if of(name):
            yield {"quantity": text, "n": len(of(name)), "value": float(np.mean(of(name)))}
    determined = of("verdict").count("relative_force")
    yield {"quantity": "clips whose relative force is determined", "n": len(clips), "value": determined / len(clips)}
