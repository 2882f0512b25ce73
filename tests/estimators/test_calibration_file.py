"""Files of what is known in newtons: what they tell, and what is wrong with them in one sentence."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from palpate.data.source.layout import InputError
from palpate.estimators.calibration_file import Calibration, read_calibration
from palpate.estimators.estimate import NoEstimate
from palpate.estimators.force_scale import SHEET_FACTOR
from palpate.physics.identifiability import NINETY
from tests.estimators.test_force_scale import KNOWN, METRIC, OTHER, UNKNOWN

FORCE = {"force_N": 4.0, "force_sd_N": 0.2, "force_time_s": 0.5}


STIFF = {"stiffness": 3.0}


def read(folder: Path, **fields: Any) -> Calibration:
    (folder / "known.yaml").write_text(yaml.safe_dump(fields))
    return read_calibration(folder / "known.yaml")


def test_a_known_force_belongs_to_the_contact_of_its_time(tmp_path: Path) -> None:
    calibration = read(tmp_path, **FORCE)
    scale = calibration.scale([OTHER, KNOWN], UNKNOWN)
    assert (scale.used, scale.homogeneous, scale.source) == ({10: 1.0}, "mass", "known force of 4 N at frame 10")
    assert math.exp(scale.log) == pytest.approx(20.0)
    assert calibration.of_one_clip
    with pytest.raises(NoEstimate, match=r"no press was estimated at 0.5 s"):
        calibration.scale([OTHER], UNKNOWN)


def test_measured_forces_tell_the_scale_where_they_are_known(tmp_path: Path) -> None:
    rows = [f"{time:.2f},{3.0 if time < 1 else 5.0}" for time in np.arange(0, 1.3, 0.1)]
    (tmp_path / "forces.csv").write_text("\n".join(["time_s,force_N", *rows]))
    calibration = read_calibration(tmp_path / "forces.csv")
    scale = calibration.scale([KNOWN, OTHER], UNKNOWN)
    assert (scale.homogeneous, scale.source) == ("mass", "forces measured at frame 10")
    assert math.exp(scale.log) == pytest.approx(3.0 / 0.2)
    assert calibration.files == (tmp_path / "forces.csv",)
    with pytest.raises(NoEstimate, match="has 3 known forces"):
        calibration.scale([OTHER], UNKNOWN)


def test_a_known_stiffness_has_its_unit(tmp_path: Path) -> None:
    metric = read(tmp_path, stiffness=80.0, stiffness_sd=8.0).scale([], METRIC)
    assert (math.exp(metric.log), metric.variance) == pytest.approx((80 * 0.2, 0.01))
    assert metric.source == "known stiffness of 80 N/m"


def test_palpations_tell_the_stiffness_of_a_sheet(tmp_path: Path) -> None:
    """10 kPa, to 10 % (one standard deviation), in 4 mm that are known to 5 %."""
    half = math.exp(0.1 * NINETY)
    found = {"young_pa": 1e4, "young_low_pa": 1e4 / half, "young_high_pa": 1e4 * half}
    (tmp_path / "calibration.json").write_text(json.dumps(found))
    calibration = read(tmp_path, palpation="calibration.json", thickness_m=0.004, thickness_sd_m=0.0002)
    scale = calibration.scale([], METRIC)
    assert math.exp(scale.log) == pytest.approx(SHEET_FACTOR * 1e4 * 0.004 * 0.2)
    assert scale.variance == pytest.approx(0.1**2 + 0.05**2)
    assert scale.source == "palpation, E = 1e+04 Pa, in a sheet of 4 mm"
    (tmp_path / "calibration.json").write_text(json.dumps({"young_pa": 1e4}))
    with pytest.raises(InputError, match="holds no E with an interval"):
        read(tmp_path, palpation="calibration.json", thickness_m=0.004)


@pytest.mark.parametrize(
    ("fields", "told"),
    [
        ({}, "nothing is known; give one of force_N, stiffness, palpation."),
        ({**FORCE, "stiffness": 3.0}, "force_N and stiffness each tell newtons; give one."),
        ({"force_N": 4.0}, "force_N and force_time_s belong together; give both."),
        ({**FORCE, "force_N": -1.0}, "force_N is -1.0; give a positive number."),
        ({**FORCE, "force_sd_N": -1.0}, "force_sd_N is -1.0; give 0 or more."),
        ({"palpation": "a.json"}, "palpation and thickness_m belong together; give both."),
        ({"newtons": 3.0}, "has the unknown key 'newtons'"),
        ({"palpation": "no.json", "thickness_m": 0.1}, "no.json can't be read as a palpation's calibration.json"),
    ],
)
def test_what_is_wrong_is_said_in_a_sentence(tmp_path: Path, fields: dict[str, Any], told: str) -> None:
    with pytest.raises(InputError) as error:
        read(tmp_path, **fields)
    assert told in str(error.value)
    assert "\n" not in str(error.value)
