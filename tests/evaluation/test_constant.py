"""Truths that the constant is the mean of: those of the split's first clips, in an order of their own."""

from __future__ import annotations

import numpy as np
import pytest
from rich.progress import Progress

from evaluation import constant
from evaluation.constant import draw_truths
from evaluation.recovery import draw_log_theta
from evaluation.suites import suite_clip_seed


def test_truths_are_those_of_the_split_s_first_clips() -> None:
    progress = Progress(disable=True)
    found = draw_truths("validation", 3, 2, 0, progress)
    drawn = [draw_log_theta((index, suite_clip_seed("validation", 3, index))).tolist() for index in range(2)]
    np.testing.assert_array_equal(found, sorted(drawn))
    (bar,) = progress.tasks
    assert (bar.description, bar.completed, bar.total) == ("truths of the validation split", 2, 2)


@pytest.mark.parametrize("places", [(0, 1, 2, 3), (3, 1, 0, 2)])
def test_what_can_not_be_drawn_is_left_out_and_the_order_does_not_matter(
    places: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    truths = {0: [-1.0, -3.0, -2.0], 1: None, 2: [-2.0, -4.0, -1.0], 3: [-1.0, -4.0, -2.0]}
    seeds = [suite_clip_seed("training", 0, index) for index in range(4)]

    def shuffled(function, tasks, workers):
        assert (tasks, workers) == (list(enumerate(seeds)), 2)
        return (function(tasks[place]) for place in places)

    monkeypatch.setattr(constant, "run_tasks", shuffled)
    monkeypatch.setattr(constant, "draw_log_theta", lambda task: truths[task[0]] and np.array(truths[task[0]]))
    found = draw_truths("training", 0, 4, 2, Progress(disable=True))
    np.testing.assert_array_equal(found, [truths[2], truths[3], truths[0]])
