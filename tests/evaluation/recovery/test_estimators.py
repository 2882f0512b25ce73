"""Estimators of the benchmark: what is refused, and what is recorded of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from palpate.estimators.open import EstimatorOptions
from palpate.evaluation.recovery.estimators import describe, opened
from palpate.models.onnx_session import SHIPPED, ModelFileError
from palpate.results.record import sha256_of
from tests.inference_inputs import write_model


def test_a_network_for_another_size_is_refused(tmp_path):
    model = write_model(tmp_path / "small.onnx")
    with pytest.raises(ModelFileError, match=r"80x48 pixels and the benchmark's has 214x120"):
        opened(EstimatorOptions("gan", model))


def test_the_record_says_what_estimates_depend_on():
    nothing = {"model_sha256": "", "weights_sha256": "", "calibrated": None}
    direct = EstimatorOptions("direct", onset="stamp", observation="contact", noise=0.002, horizon="press")
    told = {"noise": 0.002, "observation": "contact", "seen": "press", "onset": "stamp"}
    assert describe(direct) == nothing | told
    slab = describe(EstimatorOptions("direct", Path("fem"), onset="stamp"))
    assert slab == nothing | {"fits": "fem", "noise": None, "observation": None, "seen": None, "onset": "stamp"}
    network = describe(EstimatorOptions("network"))
    assert network["model_sha256"] == sha256_of(SHIPPED)
    assert len(network["weights_sha256"]) == 64
    assert network["calibrated"] is True
