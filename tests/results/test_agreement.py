"""A frame's record is never surer than its contact, and holds what its pull determines."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from palpate.estimators.estimate import LightFit
from palpate.estimators.grip.grip_estimate import PullResult
from palpate.estimators.records import FrameEstimate
from palpate.results.agreement import LESS, agreed
from palpate.results.store import PROGRAM
from tests.estimators.estimates import GOOD, NONE, frame_in_contact
from tests.results.fields import opened
from tests.results.test_writer import FRAME
from tests.tables import read_rows

pytestmark = pytest.mark.usefixtures("blank_pictures")
SURE = frame_in_contact("determined", (0.25, 0.125, -1.0), (1.1, 1.1, 1.1), contact=True, time_s=1.0)
UNKNOWN_FORCE = (math.nan,) * 3


def test_a_frame_is_no_surer_than_its_contact() -> None:
    run = dataclasses.replace(GOOD, onset_time_s=0.5)
    unsure = dataclasses.replace(run, estimate=dataclasses.replace(run.estimate, covariance=9 * np.eye(3)))
    assert unsure.verdict == "undetermined"
    assert agreed(SURE, run, UNKNOWN_FORCE).verdict == run.verdict == "determined"
    for ended in (unsure, dataclasses.replace(NONE, onset_time_s=0.5)):
        found = agreed(dataclasses.replace(SURE, alarm="below"), ended, UNKNOWN_FORCE)
        assert (found.verdict, found.determined, found.alarm) == ("undetermined", "", "unknown")
        assert found.detail.endswith(LESS)
    before = dataclasses.replace(SURE, time_s=0.4)
    assert agreed(before, unsure, UNKNOWN_FORCE) is before


def test_frames_of_a_fit_by_light_have_the_estimate_of_the_whole_press() -> None:
    estimate = dataclasses.replace(GOOD.estimate, light=LightFit())
    run = dataclasses.replace(GOOD, onset_time_s=0.5, estimate=estimate)
    assert agreed(dataclasses.replace(SURE, estimate=None), run, UNKNOWN_FORCE).estimate == estimate


def test_rows_of_a_pull_hold_its_relative_force(tmp_path: Path) -> None:
    times = np.linspace(0.04, 0.32, 8)
    grip = PullResult(0.6, 0.1, times, times / 0.32, np.full(8, 0.01))
    run = dataclasses.replace(NONE, onset_time_s=0.0, grip=grip)
    assert run.verdict == "relative_force"
    with opened(tmp_path / "clip") as output:
        for index in range(9):
            output.write(FRAME, FrameEstimate(index, index / 25, "ok", verdict="undetermined", contact=True))
        output.add(run)
        output.finish({"program": PROGRAM})
    rows = read_rows(tmp_path / "clip" / "parameters.csv")
    assert [row["verdict"] for row in rows] == ["relative_force"] * 9
    assert {row["determined"] for row in rows} == {"relative_force"}
    assert rows[0]["relative_force"] == ""
    assert [float(row["relative_force"]) for row in rows[1:]] == pytest.approx(times / 0.32, abs=1e-6)
    assert all(float(row["relative_force_low"]) < float(row["relative_force_high"]) for row in rows[1:])
