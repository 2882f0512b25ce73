"""The constant is the mean of the truths of another split's first clips."""

from __future__ import annotations

import numpy as np
import pytest
from rich.progress import Progress

from palpate.evaluation.recovery import constant
from palpate.evaluation.recovery.constant import constant_estimate
from palpate.evaluation.recovery.suites import suite_clip_seed


def test_it_is_the_mean_of_what_can_be_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    truths = {0: [-1.0, -3.0, -2.0], 1: None, 2: [-2.0, -4.0, -1.0], 3: [-1.5, -2.0, -3.0]}

    def draw(task: tuple[int, int]) -> np.ndarray | None:
        assert task[1] == suite_clip_seed("validation", 7, task[0])
        return truths[task[0]] and np.array(truths[task[0]])

    monkeypatch.setattr(constant, "draw_log_theta", draw)
    monkeypatch.setattr(constant, "CLIPS", 4)
    progress = Progress(disable=True)
    found = constant_estimate("test", 7, 0, progress)
    np.testing.assert_allclose(found.theta, np.exp([-1.5, -3.0, -2.0]) * [1, 1, -1])
    np.testing.assert_allclose(found.covariance, [[0.25, 0.25, -0.25], [0.25, 1.0, -1.0], [-0.25, -1.0, 1.0]])
    assert found.verdict == "undetermined"
    (bar,) = progress.tasks
    assert (bar.description, bar.completed, bar.total) == ("truths of the validation split", 4, 4)
