"""Newtons of a clip: rows by known forces."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from palpate.estimators.calibration_file import read_calibration
from palpate.estimators.force_scale import ClipLength
from palpate.estimators.grip.grip_estimate import PullResult
from palpate.estimators.records import InteractionEstimate
from palpate.results import calibrated as newtons
from palpate.results.store import own_files
from tests.estimators.estimates import GOOD, NONE
from tests.results.fields import opened
from tests.tables import read_rows

UNKNOWN, METRIC = ClipLength(1.0), ClipLength(0.5, 0.5)
LATER = dataclasses.replace(GOOD, onset=30, onset_frame=30, onset_time_s=1.2)


def calibrated(folder: Path, **fields: Any) -> newtons.ClipCalibration:
    (folder / "known.yaml").write_text(yaml.safe_dump(fields))
    return newtons.ClipCalibration(read_calibration(folder / "known.yaml" if fields else folder / "forces.csv"))


def concluded(told: newtons.ClipCalibration, *runs: InteractionEstimate, length: ClipLength = UNKNOWN):
    """Calibration of a clip with these runs of contact."""
    for run in runs:
        told.add(run)
    told.conclude(length)
    return told


def write_forces(folder: Path, force: np.ndarray, interval: float = 0.02) -> None:
    rows = [f"{interval * i:.4f},{value}" for i, value in enumerate(force)]
    (folder / "forces.csv").write_text("\n".join(["time_s,force_N", *rows]))


def test_every_run_has_a_row_with_its_unit_and_source(tmp_path: Path) -> None:
    """0.1 units are 2 N at frame 7: k_s of 0.5 is 10 N over half a metre."""
    told = calibrated(tmp_path, force_N=2.0, force_sd_N=0.1, force_time_s=0.3)
    concluded(told, NONE, GOOD, LATER, length=METRIC)
    none, known, later = told.rows
    assert none["detail"] == "No press was estimated in this run of contact."
    assert (known["force"], known["stiffness"], known["damping"]) == pytest.approx((2.0, 20.0, 2.4))
    assert known["stiffness_unit"] == "N/m, by known force of 2 N at frame 7"
    assert known["force_unit"] == "N, by known force of 2 N at frame 7"
    log_sd = math.sqrt(0.0025 + 0.0025 + 0.05**2)  # own, the known contact's, and the sensor's
    assert later["force_high"] / later["force"] == pytest.approx(math.exp(1.6449 * log_sd), rel=1e-4)
    assert known["force_high"] / known["force"] == pytest.approx(math.exp(1.6449 * 0.05), rel=1e-4)
    assert later["determined"] == "stiffness;damping;force"
    assert set(later) <= set(newtons.CALIBRATED.columns)


def test_without_a_known_contact_the_rows_say_why(tmp_path: Path) -> None:
    told = concluded(calibrated(tmp_path, force_N=2.0, force_time_s=9.0), GOOD)
    assert "no press was estimated at 9 s" in told.rows[0]["detail"]
    assert told.record()["reason"] == told.rows[0]["detail"]


def test_a_frame_s_force_is_known_in_newtons_once_a_scale_is_known(tmp_path: Path) -> None:
    """0.1 units at frame 7 are 2 N; ratios do where the stiffness is known; without a scale nothing is told."""
    told = calibrated(tmp_path, force_N=2.0, force_sd_N=0.1, force_time_s=0.3)
    assert told.known_force(GOOD.estimate) is None
    told.length = UNKNOWN
    assert told.known_force(GOOD.estimate) is None
    told.add(GOOD)
    log_sd = math.sqrt(0.0025 + 0.0025 + 0.05**2)  # as of another contact
    assert told.known_force(GOOD.estimate).end(1) == pytest.approx(2.0 * math.exp(1.6449 * log_sd), rel=1e-4)
    assert told.known_force(dataclasses.replace(GOOD.estimate, misfit=2.0)) is None
    assert told.known_force(dataclasses.replace(GOOD.estimate, covariance=np.eye(3))) is None
    stiff = calibrated(tmp_path, stiffness=5.0)
    stiff.length = ClipLength(1.0, 1.0)
    together = np.diag([0.0025, 0.04, 0.0025]) + 4.0 * np.ones((3, 3))  # F/k_s alone is known
    ratio = dataclasses.replace(GOOD.estimate, covariance=together)
    assert "force" not in ratio.determined
    assert stiff.known_force(ratio).end(1) == pytest.approx(
        5.0 * 0.1 / 0.5 * math.exp(1.6449 * math.sqrt(0.005)), rel=1e-4
    )


def test_a_grip_s_force_is_told_by_the_known_part(tmp_path: Path) -> None:
    times = np.linspace(0.1, 0.8, 8)
    grip = PullResult(0.6, 0.1, times, times / 0.8, np.zeros(8))
    write_forces(tmp_path, 3 * np.arange(21) * 0.02 / 0.8)
    told = calibrated(tmp_path)
    force = told.add(dataclasses.replace(NONE, onset_time_s=0.0, grip=grip))
    assert force is not None
    assert force[0] == pytest.approx(3 * times / 0.8)


@pytest.mark.usefixtures("blank_pictures")
def test_the_table_is_written_and_is_the_program_s_own(tmp_path: Path) -> None:
    write_forces(tmp_path, np.full(100, 2.0))
    told = calibrated(tmp_path)
    with opened(tmp_path / "clip", calibration=told) as output:
        output.add(GOOD)
        output.calibrate(UNKNOWN)
        output.finish({"program": "infer.py"})
    [row] = read_rows(tmp_path / "clip" / "calibrated.csv")
    assert tuple(row) == tuple(newtons.CALIBRATED.columns)
    assert "calibrated.csv" in own_files(tmp_path / "clip")
