"""The benchmark's scores equal a hand count."""

from __future__ import annotations

import cv2
import numpy as np

from palpate.benchmarks.automatic_masks import main, summary


def test_scores_of_a_hand_made_case():
    frames = [(5, 4, 3, 10.0), (5, 0, 0, 20.0), (0, 4, 0, 30.0), (0, 0, 0, 40.0)]  # annotated, reported, both, ms
    assert summary("clip", frames) == ["clip", "1 of 2", "0.25", "0.50", "0.75", "1 of 2", "25"]


def test_command_line_writes_one_row_a_clip(tmp_path, capsys):
    clip = tmp_path / "clip"
    clip.mkdir()
    for number in (1, 2):
        grey = np.full((60, 80, 3), 90, np.uint8)
        for kind in ("endo", "endo_color_mask"):
            (clip / f"frame_{number}_{kind}.png").write_bytes(cv2.imencode(".png", grey)[1].tobytes())
    assert main([str(tmp_path)]) == 0
    assert "| clip | 0 of 0 | - | - | - | 0 of 2 |" in capsys.readouterr().out
    assert main([str(tmp_path / "absent")]) == 1
    assert "absent can't be opened" in capsys.readouterr().err
