"""The benchmark of path-traced presses, on a drawn one in their layout."""

import json
import math

import numpy as np
import pytest

from benchmarks import path_traced
from palpate.data.synthetic.clip import draw_truth, write_clip
from palpate.estimators.direct.estimator import MODEL_COVARIANCE
from tests.tables import read_rows
from tests.test_infer import SCENE


def test_frames_and_errors_of_a_press_are_those_of_its_truth(tmp_path, capsys):
    folder = write_clip(tmp_path / "made", 1, SCENE, 3)
    scene, motion = draw_truth(SCENE, 3)
    frames = motion.in_contact.nonzero()[0].tolist()
    truth = {"theta": dict(zip(("stiffness", "damping", "force"), motion.theta.tolist(), strict=True)), "zeta": 0.5}
    truth |= {"contact_frames": frames, "distance_mm": 100 * float(scene.mesh.vertices[scene.vertex, 2])}
    folder.rename(tmp_path / "press")
    (tmp_path / "press.truth.json").write_text(json.dumps(truth | {"mm_per_scene_unit": 100.0}))
    arguments = ["--data", str(tmp_path), "--given", "depth", "--output", str(tmp_path / "out")]
    assert path_traced.main(arguments) == 0
    assert path_traced.main([*arguments[:2], *arguments[4:]]) == 2  # of the video alone: other results
    assert "holds results of another given" in " ".join(capsys.readouterr().err.split())
    found = {row["measure"]: row["value"] for row in read_rows(tmp_path / "out" / "table.csv")}
    assert (int(found["pressed_frames"]), int(found["other_frames"])) == (len(frames), SCENE.frames - len(frames))
    assert int(found["pressed_found"]) >= len(frames) - 1
    assert int(found["other_found"]) == 0
    assert found["verdict"] == "determined"
    for name in ("stiffness", "damping", "force"):
        error, sd = (float(found[f"{name}_{end}"]) for end in ("error", "sd"))
        assert error**2 < 16 * (sd**2 - np.diag(MODEL_COVARIANCE).min()) < 0.5**2
    summary = {row["measure"]: row for row in read_rows(tmp_path / "out" / "summary.csv")}
    assert int(summary["stiffness"]["count"]) == 1
    assert float(summary["force"]["median error"]) == pytest.approx(abs(float(found["force_error"])))


def test_summary_counts_what_is_determined_and_held():
    frames = {"pressed_frames": 9, "pressed_found": 8, "other_frames": 22, "other_found": 1}
    known = {"force_determined": 1, "force_sd": 0.1}
    rows = [frames | known | {"force_error": error} for error in (0.05, -0.15, 0.4)]
    rows.append(frames)
    found = path_traced.summarised(rows).set_index("measure")
    assert found.loc["pressed frames called contact", ["count", "of"]].tolist() == [32, 36]
    assert found.loc["other frames called contact", ["count", "of"]].tolist() == [4, 88]
    assert found.loc["force", ["count", "of"]].tolist() == [3, 4]
    assert found.loc["force", "median error"] == pytest.approx(0.15)
    assert found.loc["force", "held"] == pytest.approx(2 / 3)
    assert found.loc["damping", "count"] == 0
    assert math.isnan(found.loc["damping", "held"])


def test_a_folder_without_clips_is_a_sentence(tmp_path, capsys):
    assert path_traced.main(["--data", str(tmp_path), "--output", str(tmp_path / "out")]) != 0
    assert "holds no NAME.truth.json beside its clip" in " ".join(capsys.readouterr().err.split())
