"""The constant that estimators are compared with: the mean of true log θ over clips of a split that is not judged."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from rich.progress import Progress

from estimators.worker_pool import run_tasks
from evaluation.recovery.evaluate import draw_log_theta
from evaluation.recovery.store import replace_text
from evaluation.recovery.suites import suite_clip_seed


def kept_truths(path: Path, split: str, seed: int, count: int, workers: int, progress: Progress) -> np.ndarray:
    """True log θ of a split's first clips, shape [n, 3]; clips for which nothing can be drawn are left out.

    Args:
        path: file in which they are looked up, and kept.
        split: one of `evaluation.recovery.suites.SPLITS`.
        seed: the user's.
        count: clips, at least n.
        workers: processes; 0 = in this one.
        progress: gets a bar.

    Raises:
        OutputError: the file can't be written.
    """
    wanted = {"split": split, "seed": seed, "clips": count}
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        if {name: stored[name] for name in wanted} == wanted:
            return np.array(stored["log_theta"])
    except (OSError, ValueError, KeyError, TypeError):
        pass  # there are none, or no longer
    bar = progress.add_task(f"truths of the {split} split", total=count)
    drawn = []
    for logs in run_tasks(draw_log_theta, [(i, suite_clip_seed(split, seed, i)) for i in range(count)], workers):
        drawn += [] if logs is None else [logs.tolist()]
        progress.advance(bar)
    drawn.sort()  # whatever order they came in
    replace_text(path, json.dumps(wanted | {"log_theta": drawn}) + "\n")
    return np.array(drawn)
