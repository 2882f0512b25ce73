"""Folders of results: names, completeness, what is left after a failure."""

from __future__ import annotations

import csv
import json
import os
from pathlib import Path

import numpy as np
import pytest

from data.frames import Frame
from data.prepared import PreparedFrame
from estimators.amortized import FrameResult
from estimators.estimate import FrameEstimate
from evaluation.result_store import read_record
from evaluation.results import COLUMNS, ClipResults, table_row

REQUIRED = (
    "frame,time_s,stiffness,stiffness_sd,damping,damping_sd,force,force_sd,contact,contact_distance,contact_u,contact_v,"
    "simulated_displacement,observed_displacement,status"
)
SIZE = (64, 48)
ROW = FrameEstimate(5, 0.2, "ok", stiffness=0.25, damping=0.125, force=2.0, contact=True, contact_u=3.5, contact_v=4.0)


UNITS = {"stiffness": "scene units"}


def result() -> FrameResult:
    frame = Frame(0, 5, 0.2, np.full((SIZE[1], SIZE[0], 3), 80, np.uint8))
    depth, labels = np.ones((12, 16), np.float32), np.zeros((12, 16), np.uint8)
    return FrameResult(PreparedFrame(frame, "ok", "", depth, labels), ROW, None)


def write_clip(folder: Path, fingerprint: str = "abc", *, overlay: bool = True) -> None:
    with ClipResults(folder, SIZE, 25.0, UNITS, overlay=overlay) as output:
        output.write(result())
        output.finish({"fingerprint": fingerprint, "input": {"path": "clip.mp4"}}, title="clip", subtitle="")


def test_columns_begin_with_the_promised_ones() -> None:
    assert ",".join(COLUMNS).startswith(REQUIRED + ",")


def test_row_leaves_unknown_cells_empty() -> None:
    row = dict(zip(COLUMNS, table_row(ROW), strict=True))
    assert row["frame"] == "5"
    assert row["time_s"] == "0.200000"
    assert row["stiffness"] == "0.25"
    assert row["contact"] == "1"
    assert row["stiffness_sd"] == row["simulated_displacement"] == row["contact_distance"] == ""


def test_detail_stays_on_one_line() -> None:
    row = dict(zip(COLUMNS, table_row(FrameEstimate(1, 0.0, "no_mask", detail="one\ntwo,  three")), strict=True))
    assert row["detail"] == "one two, three"


def test_folder_is_complete_or_not_there(tmp_path: Path) -> None:
    folder = tmp_path / "clip"
    write_clip(folder)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["clip"]
    names = ["overlay.mp4", "parameters.csv", "run.json", "summary.png"]
    assert sorted(path.name for path in folder.iterdir()) == names
    with (folder / "parameters.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["force"] for row in rows] == ["2"]


def test_failure_keeps_earlier_results_and_leaves_no_rest(tmp_path: Path) -> None:
    folder = tmp_path / "clip"
    write_clip(folder, "first")

    def fail() -> None:
        with ClipResults(folder, SIZE, 25.0, UNITS) as output:
            output.write(result())
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert read_record(folder)["fingerprint"] == "first"
    assert [path.name for path in tmp_path.iterdir()] == ["clip"]


def test_new_results_replace_earlier_ones(tmp_path: Path) -> None:
    write_clip(tmp_path / "clip", "first")
    write_clip(tmp_path / "clip", "second", overlay=False)
    assert read_record(tmp_path / "clip")["fingerprint"] == "second"
    assert not (tmp_path / "clip" / "overlay.mp4").exists()


def test_rests_of_a_killed_run_are_cleared(tmp_path: Path) -> None:
    dead = 2**22 + 1  # above the largest process id of Linux
    (tmp_path / f".clip.partial-{dead}").mkdir()
    write_clip(tmp_path / f".clip.old-{dead}", "earlier")
    os.rename(tmp_path / f".clip.old-{dead}", tmp_path / ".clip.old-1")
    with ClipResults(tmp_path / "clip", SIZE, 25.0, UNITS, overlay=False):
        pass
    assert read_record(tmp_path / "clip")["fingerprint"] == "earlier"
    assert [path.name for path in tmp_path.iterdir()] == ["clip"]


def test_record_is_json_without_nan(tmp_path: Path) -> None:
    write_clip(tmp_path / "clip")
    assert json.loads((tmp_path / "clip" / "run.json").read_text())["fingerprint"] == "abc"
