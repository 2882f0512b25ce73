"""E as a palpation left it: of a whole body, and of curves that differ from place to place."""

import json
import math
from pathlib import Path

import pytest

from palpate.data.source.layout import InputError
from palpate.estimators.estimate import NINETY
from palpate.estimators.palpated import palpated_young

COLUMNS = "file,curve,quantity,value,low,high,unit"
INTERVAL = {"young_pa": 1e4, "young_low_pa": 8e3, "young_high_pa": 12.5e3}
ONE = f"{COLUMNS}\na,1,E,10,8,12.5,kPa"
SD = math.log(12.5 / 8) / (2 * NINETY)
"""Of log E, where a 90 % interval goes from 8 to 12.5."""


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_a_body_s_interval_tells_the_deviation(tmp_path: Path) -> None:
    path = written(tmp_path, "calibration.json", json.dumps(INTERVAL))
    assert palpated_young(path) == pytest.approx((1e4, SD))


def test_one_curve_is_known_as_well_as_it_says(tmp_path: Path) -> None:
    assert palpated_young(written(tmp_path, "curves.CSV", ONE)) == pytest.approx((1e4, SD))


def test_curves_differ_by_their_own_errors_and_from_place_to_place(tmp_path: Path) -> None:
    """Medians of 8, 10 and 12.5 kPa: log E varies by log 1.25; other units are passed over."""
    spread = {8.0: 1.05, 10.0: 1.1, 12.5: 1.2}
    rows = [f"a,{value:g},E,{value},{value / by},{value * by},kPa" for value, by in spread.items()]
    rows += ["a,4,stiffness,0.3,0.2,0.4,N/mm", "a,hold,relaxation time,1,,,s"]
    own = math.sqrt(sum(math.log(by) ** 2 for by in spread.values()) / 3) / NINETY
    found = palpated_young(written(tmp_path, "curves.csv", "\n".join([COLUMNS, *rows])))
    assert found == pytest.approx((1e4, math.hypot(math.log(1.25), own)))


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("calibration.json", json.dumps(INTERVAL | {"young_pa": None}), "says that nothing is determined; press hard"),
        ("calibration.json", json.dumps({"young_pa": 1e4}), "holds no E with an interval (young_pa, young_low_pa, "),
        ("calibration.json", json.dumps(INTERVAL | {"young_low_pa": 0.0}), "holds no E with an interval"),
        (
            "calibration.json",
            json.dumps(INTERVAL | {"young_high_pa": "much"}),
            "give calibration.json of palpate",
        ),
        ("calibration.json", "[]", "is not a palpation's calibration.json; write a mapping of names to values."),
        ("curves.csv", f"{COLUMNS}\na,1,stiffness,0.3,0.2,0.4,N/mm", "holds no modulus in kPa, or one that can't be"),
        ("curves.csv", ONE.replace(",8,", ",-8,"), "holds no modulus in kPa, or one that can't be"),
        ("curves.csv", ONE.replace("12.5", "inf"), "holds no modulus in kPa, or one that can't be"),
        (
            "curves.csv",
            ONE.replace("12.5", "stiff"),
            "of palpate calibrate; give curves.csv of palpate calibrate",
        ),
        ("curves.csv", "place,depth\n1,2", "is no table of palpate calibrate"),
        ("curves.csv", f"{COLUMNS}\na,1,E,10,kPa", "holds no modulus in kPa"),
    ],
)
def test_a_file_that_tells_no_e_is_refused_by_name(tmp_path: Path, name: str, text: str, said: str) -> None:
    with pytest.raises(InputError) as refused:
        palpated_young(written(tmp_path, name, text))
    assert said in str(refused.value)
    assert str(refused.value).startswith(str(tmp_path / name))


@pytest.mark.parametrize("name", ["none.csv", "none.json"])
def test_a_missing_file_is_named(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=name):
        palpated_young(tmp_path / name)
