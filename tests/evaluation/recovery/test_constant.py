"""Truths that the constant is the mean of: those of the split's first clips, in an order of their own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rich.progress import Progress

from evaluation.recovery import constant
from evaluation.recovery.constant import kept_truths
from evaluation.recovery.evaluate import draw_log_theta
from evaluation.recovery.suites import suite_clip_seed


@pytest.mark.slow
def test_truths_are_those_of_the_split_s_first_clips(tmp_path: Path) -> None:
    progress = Progress(disable=True)
    found = kept_truths(tmp_path / "truths.json", "validation", 3, 2, 0, progress)
    drawn = [draw_log_theta((index, suite_clip_seed("validation", 3, index))).tolist() for index in range(2)]
    np.testing.assert_array_equal(found, sorted(drawn))
    (bar,) = progress.tasks
    assert (bar.description, bar.completed, bar.total) == ("truths of the validation split", 2, 2)


@pytest.mark.parametrize("places", [(0, 1, 2, 3), (3, 1, 0, 2)])
def test_what_can_not_be_drawn_is_left_out_and_the_order_does_not_matter(
    places: tuple[int, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    truths = {0: [-1.0, -3.0, -2.0], 1: None, 2: [-2.0, -4.0, -1.0], 3: [-1.0, -4.0, -2.0]}
    seeds = [suite_clip_seed("training", 0, index) for index in range(4)]

    def shuffled(function, tasks, workers):
        assert (tasks, workers) == (list(enumerate(seeds)), 2)
        return (function(tasks[place]) for place in places)

    monkeypatch.setattr(constant, "run_tasks", shuffled)
    monkeypatch.setattr(constant, "draw_log_theta", lambda task: truths[task[0]] and np.array(truths[task[0]]))
    found = kept_truths(tmp_path / "truths.json", "training", 0, 4, 2, Progress(disable=True))
    np.testing.assert_array_equal(found, [truths[2], truths[3], truths[0]])


def test_truths_are_drawn_once_for_a_split_a_seed_and_a_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn, path = [], tmp_path / "truths.json"
    monkeypatch.setattr(constant, "draw_log_theta", lambda task: drawn.append(task[1]) or np.array([-1.0, -3.0, -2.0]))
    first = ("validation", 0, 1)
    for wanted in (first, first, ("training", 0, 1), ("training", 1, 1), ("training", 1, 2)):
        found = kept_truths(path, *wanted, 0, Progress(disable=True))
        np.testing.assert_array_equal(found, [[-1.0, -3.0, -2.0]] * wanted[2])
    assert len(drawn) == 1 + 1 + 1 + 2
    path.write_text("{")
    kept_truths(path, *first, 0, Progress(disable=True))
    assert len(drawn) == 6
