"""The constant that estimators are compared with: the mean of true log θ over clips of a split that is not judged."""

from __future__ import annotations

import numpy as np
from rich.progress import Progress

from estimators.worker_pool import run_tasks
from evaluation.recovery import draw_log_theta
from evaluation.suites import suite_clip_seed


def draw_truths(split: str, seed: int, count: int, workers: int, progress: Progress) -> np.ndarray:
    """True log θ of a split's first clips, shape [n, 3]; clips for which nothing can be drawn are left out.

    Args:
        split: one of `evaluation.suites.SPLITS`.
        seed: the user's.
        count: clips, at least n.
        workers: processes; 0 = in this one.
        progress: gets a bar.
    """
    bar = progress.add_task(f"truths of the {split} split", total=count)
    drawn = []
    for logs in run_tasks(draw_log_theta, [(i, suite_clip_seed(split, seed, i)) for i in range(count)], workers):
        drawn += [] if logs is None else [logs.tolist()]
        progress.advance(bar)
    return np.array(sorted(drawn))  # whatever order they came in
