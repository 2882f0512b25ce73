"""Estimates compared with the truth: numbers of what is determined only, and whether the interval holds."""

import csv
import json
import os
from pathlib import Path

import pytest

from benchmarks.compare_with_truth import main

THETA = {"stiffness": 0.4, "damping": 0.02, "force": -0.05}
ROW = {"onset_frame": "7", "onset_time_s": "0.28", "status": "ok", "detail": "", "verdict": "ratios"}
ROW |= {"determined": "stiffness;damping_over_stiffness"}
ROW |= {"stiffness": "0.41", "stiffness_low": "0.39", "stiffness_high": "0.43"}
ROW |= {"damping": "0.021", "damping_low": "0.01", "damping_high": "0.04"}
ROW |= {f"damping_over_stiffness{end}": value for end, value in (("", "0.06"), ("_low", "0.055"), ("_high", "0.065"))}


@pytest.fixture
def results(tmp_path: Path) -> Path:
    clip, folder = tmp_path / "video01_00000", tmp_path / "results"
    clip.mkdir()
    folder.mkdir()
    (clip / "truth.json").write_text(json.dumps({"theta": THETA, "onset_s": 0.28}))
    (folder / "run.json").write_text(json.dumps({"input": {"path": str(clip), "fps": 25.0}}))
    write_rows(folder, {**ROW, "onset_time_s": "0.04", "stiffness": "9"}, ROW)
    return folder


def write_rows(folder: Path, *rows: dict[str, str]) -> None:
    with (folder / "interactions.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(ROW))
        writer.writeheader()
        writer.writerows(rows)


def cells(text: str) -> dict[str, list[str]]:
    """Cells of the printed table by the first word of the quantity."""
    lines = [[cell.strip() for cell in line.split("│")[1:-1]] for line in text.splitlines() if "│" in line]
    return {line[0]: line[1:] for line in lines}


def test_only_what_is_determined_has_numbers(results, capsys, monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    assert main(["--results", str(results)]) == 0
    printed = capsys.readouterr().out
    assert "video01_00000: ratios" in printed
    assert "not N/m or N" in printed
    found = cells(printed)
    assert found["stiffness k_s"] == ["0.41", "0.39", "0.43", "0.4", "held"]
    assert found["damping k_d"] == ["not determined", "", "", "0.02", ""]
    assert found["damping_over_stiffness k_d/k_s"] == ["0.06", "0.055", "0.065", "0.05", "missed"]


def test_what_can_t_be_shown_is_said_in_a_sentence(results: Path, capsys: pytest.CaptureFixture) -> None:
    write_rows(results, {**ROW, "onset_time_s": "0.36"}, {**ROW, "status": "no_estimate", "detail": "Too short."})
    assert main(["--results", str(results)]) == 1
    told = " ".join(capsys.readouterr().err.split())
    assert "no estimate of the run of contact that truly begins at 0.28 s. Too short." in told
    write_rows(results)
    assert main(["--results", str(results)]) == 1
    assert "No contact was found." in " ".join(capsys.readouterr().err.split())
    (results.parent / "video01_00000" / "truth.json").unlink()
    assert main(["--results", str(results)]) == 1
    assert "on a clip of data.synthetic" in " ".join(capsys.readouterr().err.split())
    assert main(["--results", str(results.parent)]) == 1
    assert "holds no results of infer.py" in " ".join(capsys.readouterr().err.split())


def test_a_video_file_s_truth_lies_in_the_folder_of_its_name(results: Path, capsys: pytest.CaptureFixture) -> None:
    video = results.parent / "video01_00000.mp4"
    video.touch()
    (results / "run.json").write_text(json.dumps({"input": {"path": str(video), "fps": 25.0}}))
    assert main(["--results", str(results)]) == 0
    assert "video01_00000.mp4: ratios" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["run.json", "interactions.csv"])
@pytest.mark.parametrize(
    "make",
    [
        os.mkfifo,
        lambda path: path.symlink_to("/dev/zero"),
        lambda path: path.write_text("[" * 100_000 + "\n1\n"),
        lambda path: path.write_text("status,onset_time_s\nok,soon\n"),
        lambda path: path.write_bytes(b"\xff\xfe\x00" * 99),
    ],
    ids=["pipe", "device", "deep", "text", "binary"],
)
def test_results_that_are_none_are_one_sentence(results, capsys, name, make) -> None:
    (results / name).unlink(missing_ok=True)
    make(results / name)
    assert main(["--results", str(results)]) == 1
    told = " ".join(capsys.readouterr().err.split())
    assert "of infer.py" in told
    assert "Traceback" not in told
