"""The picture some frames ahead by physics alone: what counts, what is summed, and the door's table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from estimators.onset import STAMP
from estimators.open import EstimatorOptions
from evaluation.next_depth import NextDepthErrors, NextDepthTask, _row, _turned_row, main, next_depth_errors
from evaluation.recovery.suites import suite_clip_seed
from models.onnx_session import SHIPPED
from tests.evaluation.trained_generators import write_checkpoint


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
def test_a_generator_that_adds_nothing_to_physics_is_as_good(tmp_path: Path) -> None:
    """With the shipped head it says what the network says, and moving θ moves its picture as it moves the truth."""
    seed = suite_clip_seed("validation", 0, 3)
    network = EstimatorOptions("network", model=SHIPPED, onset=STAMP, threads=1)
    checkpoint = write_checkpoint(tmp_path / "last.ckpt")
    found = next_depth_errors(NextDepthTask("clean", 3, seed, 4, network, checkpoint))
    _, _, _, network_s, own, generated = found.total
    assert own == pytest.approx(network_s, rel=0.01)
    assert generated == pytest.approx(own, rel=0.01)
    assert found.turned.shape[1] > 100
    assert np.corrcoef(found.turned)[0, 1] > 0.9


def test_the_correlation_is_over_pixels_and_the_median_over_clips() -> None:
    simulated = np.array([1.0, 2.0, 3.0, 4.0])
    found = [NextDepthErrors(1, np.zeros(6), np.stack([factor * simulated, simulated])) for factor in (0.5, 0.5, -0.5)]
    empty = NextDepthErrors(0, np.zeros(6))
    both = np.concatenate([0.5 * simulated, 0.5 * simulated, -0.5 * simulated]), np.tile(simulated, 3)
    pooled = f"{np.corrcoef(both)[0, 1]:.2f}"
    assert _turned_row("clean", [*found, empty]) == ["clean", "3", "12", pooled, "1.00", "0.17"]
    assert _turned_row("clean", [empty]) == ["clean", "0", "0", "", "", ""]


def test_a_generator_for_other_frames_is_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    checkpoint = write_checkpoint(tmp_path / "last.ckpt")
    assert main(["--horizon", "2", "--checkpoint", str(checkpoint)]) == 1
    assert "last.ckpt predicts 4 frames ahead; give --horizon 4." in " ".join(capsys.readouterr().err.split())


@pytest.mark.slow
def test_the_door_prints_a_row_a_suite(capsys: pytest.CaptureFixture) -> None:
    assert main(["--suite", "clean", "8bit", "--clips", "1", "--workers", "0", "--split", "validation"]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[0].startswith("Depth 4 frames ahead")
    assert [line.split("|")[1].strip() for line in printed[3:]] == ["clean", "8bit"]


@pytest.mark.slow
def test_with_a_checkpoint_the_door_prints_a_second_table(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    checkpoint = str(write_checkpoint(tmp_path / "last.ckpt"))
    command = ["--suite", "clean", "--clips", "1", "--workers", "0", "--split", "validation"]
    assert main([*command, "--checkpoint", checkpoint]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert "generated / better copy" in printed[1]
    assert printed[5].startswith("θ moved to the farthest corner")
    assert [printed[place].split("|")[1:3] for place in (3, 8)] == [[" clean ", " 1 "]] * 2


def test_a_model_that_is_none_is_one_sentence(tmp_path, capsys: pytest.CaptureFixture) -> None:
    assert main(["--model", str(tmp_path / "no.onnx")]) == 1
    assert "no.onnx" in capsys.readouterr().err
