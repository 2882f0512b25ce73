"""Folders of results: names, completeness, what is left after a failure."""

import csv
import dataclasses
import json
import os
from pathlib import Path

import numpy as np
import pytest

from palpate.data.prepared import PreparedFrame
from palpate.data.source.frames import Frame
from palpate.estimators.calibration_file import read_calibration
from palpate.estimators.estimate import LightFit
from palpate.estimators.force_scale import ClipLength
from palpate.estimators.grip.grip_estimate import PullResult
from palpate.estimators.records import CONTACTS, FRAMES, FrameEstimate
from palpate.results.alarm import ForceAlarm
from palpate.results.artefacts.fit import MOST_PANELS, FitPicture
from palpate.results.calibrated import ClipCalibration
from palpate.results.store import PROGRAM, OutputError, is_up_to_date, own_files, partial_folder, read_record
from palpate.results.verdicts import state
from tests.estimators.estimates import GOOD, NONE, frame_in_contact
from tests.results.fields import PULL, SIZE, UNKNOWN, opened
from tests.tables import read_rows

pytestmark = pytest.mark.usefixtures("blank_pictures")
SEEN = Frame(0, 5, 0.2, np.full((SIZE[1], SIZE[0], 3), 80, np.uint8))
FRAME = PreparedFrame(SEEN, "ok", "", np.ones((12, 16), np.float32), np.zeros((12, 16), np.uint8))
ESTIMATE = frame_in_contact("undetermined", (0.25, 0.125, -2.0), contact=True)
NONE_SEEN = FrameEstimate(8, 0.32, "no_tool")
NAMES = ["fit.png", "forces.json", "interactions.csv", "overlay.mp4", "parameters.csv", "results.json", "run.json"]


def write_clip(folder: Path, fingerprint: str = "abc", *, overlay: bool = True) -> None:
    with opened(folder, overlay=overlay) as output:
        output.write(FRAME, ESTIMATE)
        output.add(GOOD)
        record = {"program": PROGRAM, "fingerprint": fingerprint, "input": {"path": "clip.mp4"}}
        output.finish(record)


def test_folder_is_complete_or_not_there(tmp_path: Path) -> None:
    folder = tmp_path / "clip"
    write_clip(folder)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["clip"]
    assert sorted(path.name for path in folder.iterdir()) == NAMES
    assert json.loads((folder / "run.json").read_text())["fingerprint"] == "abc"
    assert [row["force"] for row in read_rows(folder / "parameters.csv")] == ["2"]
    assert [(row["onset_frame"], row["force"]) for row in read_rows(folder / "interactions.csv")] == [("7", "0.1")]


def test_a_clip_without_frames_and_contact_has_the_tables_heads(tmp_path: Path) -> None:
    with opened(tmp_path / "clip") as output:
        output.finish({})
    for name, columns in (("parameters.csv", FRAMES.without("alarm")), ("interactions.csv", CONTACTS)):
        with (tmp_path / "clip" / name).open(encoding="utf-8", newline="") as stream:
            assert list(csv.reader(stream)) == [list(columns.columns)]


def test_a_known_force_that_does_not_reach_a_pull_is_said(tmp_path: Path) -> None:
    """Half of the first run of contact is measured, nothing of the last."""
    times = np.linspace(0.1, 0.8, 8)
    grip = PullResult(0.6, 0.1, times, times / 0.8, np.zeros(8))
    run = dataclasses.replace(NONE, onset_time_s=0.5, grip=grip)
    late = dataclasses.replace(run, onset_time_s=5.0)
    times_s = np.linspace(0.5, 0.9, 3)
    table = "\n".join(f"{time},{force}" for time, force in zip(times_s, 3.75 * (times_s - 0.5), strict=True))
    (tmp_path / "forces.csv").write_text(f"time_s,force_N\n{table}\n")
    calibration = ClipCalibration(read_calibration(tmp_path / "forces.csv"))
    with opened(tmp_path / "clip", calibration=calibration) as output:
        for item in (run, NONE, late):
            output.add(item)
        output.calibrate(ClipLength(1.0))
        output.finish({"program": PROGRAM})
    said = [row["detail"] for row in read_rows(tmp_path / "clip" / "interactions.csv")]
    assert "force" not in said[0]
    assert said[2].endswith("The force is known in 0 frames that move; 3 are needed for others.")
    assert "calibrated.csv" in own_files(tmp_path / "clip")
    assert calibration.reason == ""


def test_an_alarm_has_a_column_and_goes_on_until_its_run_ends(tmp_path: Path) -> None:
    alarm = ForceAlarm(1.0, "N", 1.0)
    sure, less, least = (
        frame_in_contact("determined", (0.25, 0.125, force), (1.1, 1.1, 1.1), contact=True)
        for force in (-1.2, -1.05, -0.85)
    )
    with opened(tmp_path / "clip", alarm=alarm) as output:
        for item in (ESTIMATE, sure, less, GOOD, least, dataclasses.replace(NONE_SEEN, contact=False)):
            output.add(item) if item is GOOD else output.write(FRAME, item)
        output.finish({"program": PROGRAM})
    found = read_rows(tmp_path / "clip" / "parameters.csv")
    assert tuple(found[0]) == tuple(FRAMES.columns)
    assert [row["alarm"] for row in found] == ["unknown", "above", "above", "below", ""]
    assert alarm.record()["frames"] == {"no_contact": 1, "below": 1, "above": 2, "unknown": 1}


def test_runs_of_contact_are_counted_by_verdict_and_those_with_a_motion_are_drawn_first(tmp_path: Path) -> None:
    loose = dataclasses.replace(GOOD, estimate=dataclasses.replace(GOOD.estimate, covariance=np.eye(3)))
    with opened(tmp_path / "clip") as output:
        assert output.counts == {}
        for run in [NONE] * MOST_PANELS + [GOOD, loose, GOOD]:
            output.add(run)
        assert output.counts == {"determined": 2, "undetermined": 1, "no_estimate": MOST_PANELS}
        [picture] = (item for item in output.artefacts if isinstance(item, FitPicture))
        drawn = [state(run) for run in picture.drawn]
    assert drawn == ["determined", "undetermined", "determined"] + ["no_estimate"] * (MOST_PANELS - 3)


def test_failure_keeps_earlier_results_and_leaves_no_rest(tmp_path: Path) -> None:
    folder = tmp_path / "clip"
    write_clip(folder, "first")

    def fail() -> None:
        with opened(folder, overlay=True) as output:
            output.write(FRAME, ESTIMATE)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert read_record(folder)["fingerprint"] == "first"
    assert [path.name for path in tmp_path.iterdir()] == ["clip"]


def test_rests_of_a_killed_run_are_cleared(tmp_path: Path) -> None:
    write_clip(tmp_path / "clip", "earlier")
    killed = partial_folder(tmp_path / "clip")
    for name in ("parameters.csv", ".fit.png.partial"):
        (killed / name).write_text("unfinished")
    killed.rename(tmp_path / f".clip.partial-{2**22 + 1}")  # above the largest process id of Linux
    with opened(tmp_path / "clip"):
        pass
    assert read_record(tmp_path / "clip")["fingerprint"] == "earlier"
    assert [path.name for path in tmp_path.iterdir()] == ["clip"]


def test_an_interruption_while_files_are_moved_ends_with_the_new_results(tmp_path, monkeypatch) -> None:
    folder, replace, left = tmp_path / "clip", os.replace, [3]
    write_clip(folder, "first")

    def interrupt(source: Path, target: Path) -> None:
        left[0] -= Path(target).parent == folder
        if not left[0]:
            left[0] = -1
            raise KeyboardInterrupt
        replace(source, target)

    monkeypatch.setattr("palpate.results.store.os.replace", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_clip(folder, "second")
    assert left[0] < 0
    assert read_record(folder)["fingerprint"] == "second"
    assert is_up_to_date(folder, "second", own_files(folder), overwrite=False)
    assert [path.name for path in tmp_path.iterdir()] == ["clip"]


def test_a_user_s_files_stay_beside_new_results(tmp_path: Path) -> None:
    folder = tmp_path / "clip"
    write_clip(folder, "first")
    (folder / "notes").mkdir()
    (folder / "notes" / "mine.txt").write_text("mine")
    write_clip(folder, "second", overlay=False)
    assert read_record(folder)["fingerprint"] == "second"
    assert not (folder / "overlay.mp4").exists()
    assert (folder / "notes" / "mine.txt").read_text() == "mine"
    (folder / "overlay.mp4").write_text("mine")
    with pytest.raises(OutputError, match=r"overlay.mp4: is not as this program wrote it"):
        write_clip(folder, "third")
    assert (folder / "overlay.mp4").read_text() == "mine"
    assert read_record(folder)["fingerprint"] == "second"


def test_fields_that_are_not_explained_or_not_determined_are_undetermined(tmp_path: Path) -> None:
    runs = [
        dataclasses.replace(PULL, last=dataclasses.replace(UNKNOWN, skill=skill), stretched=stretched)
        for skill, stretched in ((0.0, True), (0.6, True), (0.6, False), (float("nan"), False))
    ]
    with opened(tmp_path / "clip") as output:
        for field in (PULL, *runs):
            output.add(dataclasses.replace(NONE, field=field))
        assert output.counts == {"stiffness_ratios": 1, "undetermined": 4}
        assert output.stretched
        output.finish({"program": PROGRAM})
    found = read_rows(tmp_path / "clip" / "interactions.csv")
    assert [(row["status"], row["verdict"], row["determined"]) for row in found[:2]] == [
        ("ok", "stiffness_ratios", "stiffness_ratios"),
        ("ok", "undetermined", ""),
    ]
    assert [row["skill"] for row in found] == ["0.75", "0", "0.6", "0.6", ""]


def test_the_fit_of_a_press_by_its_shading_stands_in_all_its_frames(tmp_path: Path) -> None:
    fit = dataclasses.replace(GOOD.estimate, light=LightFit(lag=0.4))
    empty = dataclasses.replace(ESTIMATE, estimate=None, verdict="")
    with opened(tmp_path / "clip") as output:
        for contact in (False, True, True, False):
            output.write(FRAME, dataclasses.replace(empty, contact=contact))
        output.add(dataclasses.replace(GOOD, onset=1, onset_time_s=0.0, estimate=fit))
        output.write(FRAME, dataclasses.replace(empty, contact=True))  # of a run that has no record
        output.finish({"program": PROGRAM})
        assert output.lag == 0.4
    rows = read_rows(tmp_path / "clip" / "parameters.csv")
    force = pytest.approx(abs(fit.theta[2]))
    assert [float(row["force"] or 0) for row in rows] == [0, force, force, 0, 0]
    assert [row["verdict"] for row in rows] == ["", fit.verdict, fit.verdict, "", ""]
