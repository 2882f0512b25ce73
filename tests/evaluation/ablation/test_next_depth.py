"""The picture some frames ahead by physics alone: what counts, what is summed, and the door's table."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from palpate.evaluation.ablation.__main__ import main
from palpate.evaluation.ablation.next_depth import NextDepth, next_depth_errors, table
from palpate.evaluation.harness import Row
from tests.evaluation.ablation.trained_generators import write_checkpoint


def test_physics_with_the_right_tissue_beats_copying(tmp_path: Path) -> None:
    (found,) = next_depth_errors((NextDepth(tmp_path, split="validation"), ("clean", 0)))
    assert found["pixels"] > 20
    last, mean, true, network_s = found["total"] / found["pixels"]
    assert min(last, mean) > 0.002  # two of the noise's standard deviations
    assert true < 0.5 * min(last, mean)
    assert network_s < 0.6 * min(last, mean)


def rows_of(suite: str, *found: tuple[int, list[float]]) -> list[Row]:
    return [{"suite": suite, "pixels": pixels, "total": np.array(total)} for pixels, total in found]


def test_a_row_is_the_mean_over_pixels_and_its_ratios() -> None:
    found = rows_of("noisy", (10, [0.04, 0.05, 0.01, 0.02]), (0, [0.0] * 4), (30, [0.16, 0.07, 0.01, 0.04]))
    (row,) = table(found).to_dict("records")
    assert list(row.values())[:3] == ["noisy", 2, 40]
    assert list(row.values())[3:] == pytest.approx([0.005, 0.003, 0.0005, 0.0015, 0.5 / 3, 0.5])


@pytest.mark.slow
def test_a_generator_that_adds_nothing_to_physics_is_as_good(tmp_path: Path) -> None:
    """With the shipped head it says what the network says."""
    checkpoint = write_checkpoint(tmp_path / "last.ckpt")
    (found,) = next_depth_errors((NextDepth(tmp_path, split="validation", checkpoint=checkpoint), ("clean", 3)))
    _, _, _, network_s, own, generated = found["total"]
    assert own == pytest.approx(network_s, rel=0.01)
    assert generated == pytest.approx(own, rel=0.01)


def test_a_generator_for_other_frames_or_a_model_that_is_none_is_one_sentence(tmp_path: Path, capsys) -> None:
    checkpoint = write_checkpoint(tmp_path / "last.ckpt")
    for told, said in (
        (["--horizon", "2", "--checkpoint", str(checkpoint)], "last.ckpt predicts 4 frames ahead; give --horizon 4."),
        (["--model", str(tmp_path / "no.onnx")], "no.onnx"),
    ):
        assert main(["next-depth", "--output", str(tmp_path / "out"), *told]) == 2
        assert said in " ".join(capsys.readouterr().err.split())


@pytest.mark.slow
def test_the_door_writes_a_row_a_suite(tmp_path: Path) -> None:
    checkpoint = str(write_checkpoint(tmp_path / "last.ckpt"))
    command = ["next-depth", "--suite", "clean", "8bit", "--clips", "1", "--workers", "0", "--split", "validation"]
    assert main([*command, "--checkpoint", checkpoint, "--output", str(tmp_path / "out")]) == 0
    found = pd.read_csv(tmp_path / "out" / "table.csv")
    assert found["suite"].tolist() == ["clean", "8bit"]
    assert "generated / better copy" in found.columns
