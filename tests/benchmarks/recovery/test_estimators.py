"""Estimators of the benchmark: what is refused, and what is recorded of them."""

import numpy as np
import pytest
from rich.progress import Progress

from benchmarks.recovery import estimators
from benchmarks.recovery.estimators import constant_estimate, describe, opened
from benchmarks.recovery.suites import suite_clip_seed
from palpate.estimators.open import EstimatorOptions
from palpate.models.onnx_session import SHIPPED, ModelFileError
from palpate.results.record import sha256_of
from tests.inference_inputs import write_model


def test_a_network_for_another_size_is_refused(tmp_path):
    model = write_model(tmp_path / "small.onnx")
    with pytest.raises(ModelFileError, match=r"80x48 pixels and the benchmark's has 214x120"):
        opened(EstimatorOptions("gan", model))


def test_the_record_says_what_estimates_depend_on():
    nothing = {"model_sha256": "", "weights_sha256": "", "calibrated": None}
    direct = EstimatorOptions("direct", onset="stamp", noise=0.002, horizon="press")
    told = {"noise": 0.002, "seen": "press", "onset": "stamp"}
    assert describe(direct) == nothing | told
    network = describe(EstimatorOptions("network"))
    assert network["model_sha256"] == sha256_of(SHIPPED)
    assert len(network["weights_sha256"]) == 64
    assert network["calibrated"] is True


def test_the_constant_is_the_mean_of_what_can_be_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    truths = {0: [-1.0, -3.0, -2.0], 1: None, 2: [-2.0, -4.0, -1.0], 3: [-1.5, -2.0, -3.0]}

    def draw(task: tuple[int, int]) -> np.ndarray | None:
        assert task[1] == suite_clip_seed("validation", 7, task[0])
        return truths[task[0]] and np.array(truths[task[0]])

    monkeypatch.setattr(estimators, "draw_log_theta", draw)
    monkeypatch.setattr(estimators, "CONSTANT_CLIPS", 4)
    progress = Progress(disable=True)
    found = constant_estimate("test", 7, 0, progress)
    np.testing.assert_allclose(found.theta, np.exp([-1.5, -3.0, -2.0]) * [1, 1, -1])
    np.testing.assert_allclose(found.covariance, [[0.25, 0.25, -0.25], [0.25, 1.0, -1.0], [-0.25, -1.0, 1.0]])
    assert found.verdict == "undetermined"
    (bar,) = progress.tasks
    assert (bar.description, bar.completed, bar.total) == ("truths of the validation split", 4, 4)
