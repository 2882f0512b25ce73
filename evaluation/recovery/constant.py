"""The constant that estimators are compared with: the mean of true log θ over clips of a split that is not judged."""

from __future__ import annotations

import numpy as np
from rich.progress import Progress

from palpate.common.workers import run_tasks
from palpate.data.synthetic.clip import draw_press
from palpate.data.synthetic.scene import SceneError
from palpate.estimators.estimate import Estimate
from palpate.evaluation.recovery.suites import FITTED_ON, SUITES, suite_clip_seed
from palpate.physics.mechanics import theta_of

CLIPS = 60
"""Truths whose mean it is: over all clips its error is then within 1 % of the least."""


def constant_estimate(split: str, seed: int, workers: int, progress: Progress) -> Estimate:
    """The same θ whatever is seen, as wide as the parameters it was fitted on.

    Args:
        split: whose clips are judged, one of `evaluation.recovery.suites.SPLITS`.
        seed: the user's.
        workers: processes; 0 = in this one.
        progress: gets a bar.
    """
    fitted_on = FITTED_ON[split]
    tasks = [(index, suite_clip_seed(fitted_on, seed, index)) for index in range(CLIPS)]
    drawn = run_tasks(draw_log_theta, tasks, workers, ordered=True)
    bar = progress.track(drawn, total=CLIPS, description=f"truths of the {fitted_on} split")
    logs = np.array([logs for logs in bar if logs is not None])
    return Estimate(theta_of(logs.mean(axis=0)), np.cov(logs.T), told_verdict="undetermined")


def draw_log_theta(task: tuple[int, int]) -> np.ndarray | None:
    """True log |θ| of a clip, shape [3], without its pictures; None where nothing can be drawn.

    Args:
        task: index and seed of the clip.
    """
    index, seed = task
    try:
        _, motion = draw_press(SUITES["clean"].truth_settings(index), seed)
    except SceneError:
        return None
    return np.log(np.abs(motion.theta))
