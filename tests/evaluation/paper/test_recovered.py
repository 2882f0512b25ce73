"""Estimates compared with the truth of synthetic clips: factors, ranks, and what is said of files that are none."""

import json
import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from palpate.evaluation.paper.recovered import COLUMNS, main, read_contacts, recovery_row

TRUTHS = {"video10_00000": (0.2, 0.02, -0.1), "video10_00080": (0.4, 0.08, -0.2), "video10_00160": (0.8, 0.32, -0.4)}


def written(folder: Path, estimates: dict[str, list[tuple[float, float, float]]]) -> tuple[Path, Path]:
    """An evaluation of three contacts, and their truth."""
    clips, evaluation = folder / "clips", folder / "evaluation"
    evaluation.mkdir()
    for clip, theta in TRUTHS.items():
        (clips / "video10" / clip).mkdir(parents=True)
        truth = {"theta": dict(zip(("stiffness", "damping", "force"), theta, strict=True))}
        (clips / "video10" / clip / "truth.json").write_text(json.dumps(truth))
    rows = [(clip, *one) for clip, several in estimates.items() for one in several]
    pd.DataFrame(rows, columns=["clip", "stiffness", "damping", "force"]).to_csv(evaluation / "per_frame.csv")
    return evaluation, clips


def test_a_perfect_estimate_is_off_by_a_factor_of_one(tmp_path):
    perfect = {clip: [(theta[0], theta[1], -theta[2])] * 2 for clip, theta in TRUTHS.items()}
    frames = read_contacts(*written(tmp_path, perfect))
    for name in ("stiffness", "damping", "force", "damping_over_stiffness"):
        row = dict(zip(COLUMNS, recovery_row(name, frames), strict=True))
        assert (row["typical factor off"], row["rank correlation"]) == ("1", "1")
    # Truths a factor of 4 apart, and their geometric mean: off by 4, 1, 4.
    assert dict(zip(COLUMNS, recovery_row("damping", frames), strict=True))["of the constant"] == "4"


def test_a_constant_has_no_rank_and_one_that_errs_is_off_by_its_factor(tmp_path):
    constant = {clip: [(0.5, 0.02 * 3, 0.0)] * 2 for clip in TRUTHS}
    frames = read_contacts(*written(tmp_path, constant))
    row = dict(zip(COLUMNS, recovery_row("stiffness", frames), strict=True))
    assert (row["truth"], row["estimate"], row["rank correlation"], row["p"]) == ("0.2 to 0.8", "0.5 ± 0", "–", "–")
    assert float(row["typical factor off"]) == pytest.approx(1.6)  # of 2.5, 1.25, 1.6
    assert np.isfinite(np.log(frames["force"])).all()  # of a force of 0, too


def test_the_door_prints_five_quantities_and_says_what_is_missing(tmp_path, capsys):
    evaluation, clips = written(tmp_path, {clip: [(0.5, 0.1, 0.1)] for clip in TRUTHS})
    assert main([str(evaluation), str(clips)]) == 0
    out = capsys.readouterr().out
    assert "3 test frames of 3 contacts" in out
    assert out.count("\n| ") == 7
    (clips / "video10" / "video10_00080" / "truth.json").unlink()
    for folders, told in (((evaluation, clips), "video10_00080"), ((tmp_path / "no", clips), "holds no per_frame.csv")):
        assert main([str(folder) for folder in folders]) == 1
        assert told in capsys.readouterr().err.replace("\n", "")


def row_of_a_clip(path: Path) -> None:
    path.write_text("clip,stiffness,damping,force\nvideo01_00000,2,3,4\n")


@pytest.mark.parametrize(
    ("table", "truth", "told"),
    [
        (os.mkfifo, "{}", "holds no per_frame.csv of train.py test (no file but a pipe or a device"),
        (lambda path: path.write_bytes(bytes(range(128, 256))), "{}", "holds no per_frame.csv of train.py test"),
        (lambda path: path.write_text("clip,stiffness\n"), "{}", "holds no per_frame.csv of train.py test"),
        (lambda path: path.write_text("clip,stiffness,damping,force\n"), "{}", "a row without a clip, or none"),
        (lambda path: path.write_text("clip,stiffness,damping,force\n1,2,x,4\n"), "{}", "holds no per_frame.csv"),
        (row_of_a_clip, "[" * 100_000, "truth.json is no truth of data.synthetic (it is built otherwise)"),
        (row_of_a_clip, "null", "truth.json is no truth of data.synthetic (it is built otherwise)"),
        (row_of_a_clip, '{"theta": {"stiffness": 1, "damping": 1, "force": 0}}', "finite numbers other than 0"),
        (row_of_a_clip, '{"theta": {"stiffness": "a", "damping": 1, "force": 1}}', "truth.json is no truth"),
        (lambda path: path.write_text("clip,stiffness,damping,force\na,1e308,2,4\n"), "{}", "no number up to 1e+15"),
        (lambda path: path.write_text("clip,stiffness,damping,force\na,nan,2,4\n"), "{}", "no number up to 1e+15"),
        (
            row_of_a_clip,
            '{"theta": {"foundation": 1}}',
            "truth.json is no truth of data.synthetic (there is no 'stiffness')",
        ),
    ],
)
def test_what_can_t_be_compared_is_a_sentence(tmp_path, capsys, table, truth, told) -> None:
    clip = tmp_path / "clips" / "video01" / "video01_00000"
    clip.mkdir(parents=True)
    (clip / "truth.json").write_text(truth)
    table(tmp_path / "per_frame.csv")
    assert main([str(tmp_path), str(tmp_path / "clips")]) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert told.replace(" ", "") in said.replace(" ", "")
    assert "Traceback" not in said
