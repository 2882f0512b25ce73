"""Estimators of the benchmark on clips whose answers are known."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.open import SHIPPED, EstimatorOptions
from evaluation.recovery.estimators import ConstantOptions, describe, opened
from models.onnx_session import ModelFileError
from results.record import sha256_of
from tests.estimators.sessions import clip_info, follow, prepared_frame, touched
from tests.evaluation.simple_contacts import sheet
from tests.inference_inputs import write_model

CONSTANT = ConstantOptions(((0.0, -1.0, -2.0), (1.0, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, 3.0)))


def test_the_constant_answers_the_same_of_every_run_of_contact():
    geometry = touched(sheet(), 14, np.array([0.0, 0.0, -1.0]), 0.001)
    position = geometry.mesh.vertices[14]
    frames = [
        prepared_frame(index, "ok" if start >= 0 else "no_contact", *[geometry] * (start >= 0), consecutive=True,
                       track_start=start, track_position=position)
        for index, start in enumerate((-1, 1, 1, -1, -1, -1, 6, 6))
    ]  # fmt: skip
    told, runs = follow(opened(CONSTANT).start(clip_info()), frames)
    assert [run.onset for run in runs] == [1, 6]
    assert [frame.status for frame in told] == [frame.status for frame in frames]
    for run in runs:
        np.testing.assert_allclose(run.estimate.theta, [1.0, np.exp(-1), -np.exp(-2)])
        np.testing.assert_array_equal(run.estimate.covariance, np.diag([1.0, 2.0, 3.0]))


def test_a_network_for_another_size_is_refused(tmp_path):
    model = write_model(tmp_path / "small.onnx")
    with pytest.raises(ModelFileError, match=r"80x48 pixels and the benchmark's has 214x120"):
        opened(EstimatorOptions("gan", model))


def test_the_record_says_what_estimates_depend_on():
    assert describe(CONSTANT) == {}
    nothing = {"model_sha256": "", "weights_sha256": "", "calibrated": None}
    direct = EstimatorOptions("direct", onset="stamp", noise=0.002, horizon="press")
    assert describe(direct) == nothing | {"noise": 0.002, "seen": "press", "onset": "stamp"}
    network = describe(EstimatorOptions("network"))
    assert network["model_sha256"] == sha256_of(SHIPPED)
    assert len(network["weights_sha256"]) == 64
    assert network["calibrated"] is True
