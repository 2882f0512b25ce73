"""The picture some frames ahead by physics alone: what counts, what is summed, and the door's table."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.onset import STAMP
from estimators.open import EstimatorOptions
from evaluation.next_depth import NextDepthErrors, NextDepthTask, _row, main, next_depth_errors
from evaluation.recovery.suites import suite_clip_seed
from models.onnx_session import SHIPPED


def test_physics_with_the_right_tissue_beats_copying() -> None:
    seed = suite_clip_seed("validation", 0, 0)
    network = EstimatorOptions("network", model=SHIPPED, onset=STAMP, threads=1)
    found = next_depth_errors(NextDepthTask("clean", 0, seed, 4, network))
    assert found.pixels > 20
    last, mean, true, network_s = found.total / found.pixels
    assert min(last, mean) > 0.002  # two of the noise's standard deviations
    assert true < 0.5 * min(last, mean)
    assert network_s < 0.6 * min(last, mean)


def test_a_row_is_the_mean_over_pixels_and_its_ratios() -> None:
    found = [
        NextDepthErrors(10, np.array([0.04, 0.05, 0.01, 0.02])),
        NextDepthErrors(0, np.zeros(4)),
        NextDepthErrors(30, np.array([0.16, 0.07, 0.01, 0.04])),
    ]
    assert _row("noisy", found) == ["noisy", "2", "40", "0.00500", "0.00300", "0.00050", "0.00150", "0.17", "0.50"]


@pytest.mark.slow
def test_the_door_prints_a_row_a_suite(capsys: pytest.CaptureFixture) -> None:
    assert main(["--suite", "clean", "8bit", "--clips", "1", "--workers", "0", "--split", "validation"]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[0].startswith("Depth 4 frames ahead")
    assert [line.split("|")[1].strip() for line in printed[3:]] == ["clean", "8bit"]


def test_a_model_that_is_none_is_one_sentence(tmp_path, capsys: pytest.CaptureFixture) -> None:
    assert main(["--model", str(tmp_path / "no.onnx")]) == 1
    assert "no.onnx" in capsys.readouterr().err
