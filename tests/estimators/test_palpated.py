"""E as a palpation left it."""

import json
import math
from pathlib import Path

import pytest

from palpate.data.source.layout import InputError
from palpate.estimators.palpated import palpated_young
from palpate.physics.identifiability import NINETY

INTERVAL = {"young_pa": 1e4, "young_low_pa": 8e3, "young_high_pa": 12.5e3}
SD = math.log(12.5 / 8) / (2 * NINETY)
"""Standard deviation of log E, where a 90 % interval goes from 8 to 12.5."""


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_a_body_s_interval_tells_the_deviation(tmp_path: Path) -> None:
    path = written(tmp_path, "calibration.json", json.dumps(INTERVAL))
    assert palpated_young(path) == pytest.approx((1e4, SD))


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("calibration.json", json.dumps(INTERVAL | {"young_pa": None}), "says that nothing is determined; press hard"),
        ("calibration.json", json.dumps({"young_pa": 1e4}), "holds no E with an interval; give calibration.json"),
        ("calibration.json", json.dumps(INTERVAL | {"young_low_pa": 0.0}), "holds no E with an interval"),
        ("calibration.json", json.dumps(INTERVAL | {"young_high_pa": "much"}), "give calibration.json of palpate"),
        ("calibration.json", "[]", "is not a palpation's calibration.json; write a mapping of names to values."),
    ],
)
def test_a_file_that_tells_no_e_is_refused_by_name(tmp_path: Path, name: str, text: str, said: str) -> None:
    with pytest.raises(InputError) as refused:
        palpated_young(written(tmp_path, name, text))
    assert said in str(refused.value)
    assert str(refused.value).startswith(str(tmp_path / name))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.json"):
        palpated_young(tmp_path / "none.json")
