"""The benchmark's scores equal a hand count."""

from __future__ import annotations

import csv

import cv2
import numpy as np

from benchmarks.automatic_masks import Scores, main


def test_scores_of_a_hand_made_case():
    truth, found, none = (np.zeros((4, 5), bool) for _ in range(3))
    truth[0], found[0, :3], found[1, 0] = True, True, True
    scores = Scores("clip")
    scores.add(1, truth, found, 0.010)
    scores.add(2, truth, none, 0.020)
    scores.add(3, none, found, 0.030)
    scores.add(4, none, none, 0.040)
    assert [row["iou"] for row in scores.rows] == [0.5, 0.0, 0.0, 1.0]
    assert scores.rows[0]["precision"] == 0.75
    assert scores.rows[0]["recall"] == 0.6
    assert scores.summary() == "| clip | 1 of 2 | 0.25 | 0.50 | 0.75 | 1 of 2 | 25 |"


def test_command_line_writes_one_row_a_frame(tmp_path, capsys):
    clip = tmp_path / "clip"
    clip.mkdir()
    for number in (1, 2):
        grey = np.full((60, 80, 3), 90, np.uint8)
        for kind in ("endo", "endo_color_mask"):
            (clip / f"frame_{number}_{kind}.png").write_bytes(cv2.imencode(".png", grey)[1].tobytes())
    output = tmp_path / "scores.csv"
    assert main([str(tmp_path), "--output", str(output)]) == 0
    assert "| clip | 0 of 0 | - | - | - | 0 of 2 |" in capsys.readouterr().out
    with output.open() as file:
        assert [row["frame"] for row in csv.DictReader(file)] == ["1", "2"]
    assert main([str(tmp_path / "absent")]) == 1
    assert "absent can't be opened" in capsys.readouterr().err
