"""Drawn tissue predicted ahead: by what, from what, and how it is judged."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.real import predicted
from benchmarks.real.__main__ import main
from benchmarks.real.pulled import PulledClip
from palpate.data.source.layout import InputError
from palpate.estimators.online.forecast import FIELD, SHEET
from palpate.estimators.online.settings import OnlineSettings
from tests.benchmarks.real_clips import SIZE, pull_clip, tool_mask

SETTINGS = OnlineSettings(particles=200)


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> PulledClip:
    """Fourteen frames: one prediction, from the third after the first."""
    return pull_clip(tmp_path_factory.mktemp("pulled"), np.linspace(0, 1.5, 14))


@pytest.fixture(scope="module")
def found(clip: PulledClip) -> dict[str, Any]:
    return predicted.evaluate_prediction(clip, SETTINGS)


def test_the_first_frame_s_sheet_lies_on_its_tissue(clip: PulledClip) -> None:
    surface = predicted.first_surface(clip, SETTINGS)
    assert 0.7 * SETTINGS.particles < surface.body.count < 1.3 * SETTINGS.particles
    column, row = np.clip(surface.pixels.round().astype(int), 0, np.array(SIZE) - 1).T
    assert not tool_mask(0)[row, column].any()
    assert len(surface.gripped) > 3


def test_skill_is_one_less_error_over_motion() -> None:
    moved = np.array([[3.0, 4.0], [0.0, 5.0]])
    assert predicted.skill(moved + np.array([0.0, 2.0]), moved) == pytest.approx(1 - 2 / 5)
    assert predicted.skill(0 * moved, moved) == 0


def test_both_are_judged_by_the_same_points(found: dict[str, Any]) -> None:
    told = found
    assert (told["status"], told["estimator"]) == ("ok", "online")
    assert told["points from frame 3"] > 100
    assert told["motion since frame 3 [px]"] > 1
    assert told["skill of online, mean"] == told["skill from frame 3, online"]
    assert told["skill from frame 3, online"] > 0.2
    assert told["skill from frame 3, sheet"] > 0.3
    assert told["skill from frame 3, online"] > told["skill from frame 3, sheet"] - 0.05
    assert told["model from frame 3"] in (FIELD, SHEET)
    assert not any("frame 4" in name for name in told)  # there are no ten frames after it


def test_what_can_t_be_predicted_is_a_sentence(tmp_path: Path) -> None:
    short = pull_clip(tmp_path, np.linspace(0, 1.5, predicted.AHEAD + 3))
    with pytest.raises(InputError, match=r"fewer than 14 usable frames; give more of them"):
        predicted.evaluate_prediction(short, SETTINGS)


def test_the_door_writes_skill(clip: PulledClip, tmp_path: Path) -> None:
    (tmp_path / "online.yaml").write_text("particles: 200\nmethod: {name: PBD}\n")
    told = ["--settings", str(tmp_path / "online.yaml")]
    told += ["--pulled", str(clip.path), "--layout", str(clip.layout_file)]
    told += ["--estimator", "online", "--output", str(tmp_path)]
    assert main(told) == 0
    table = (tmp_path / "table.csv").read_text(encoding="utf-8")
    name = clip.path.name
    assert f'{name},"skill from frame 3, online",' in table
    assert f"{name},known particles,0\n" in table.replace("\r", "")  # PBD sees nothing
    assert f'{name},"skill of sheet from rest, mean",' in table


def test_a_volume_is_predicted_by_what_is_seen_of_it(clip: PulledClip, found: dict[str, Any]) -> None:
    thick = predicted.evaluate_prediction(clip, OnlineSettings(particles=200, thickness=0.1))
    assert thick["points from frame 3"] == pytest.approx(found["points from frame 3"], rel=0.2)
    assert thick["skill from frame 3, online"] > 0.4


def test_settings_that_can_t_be_used_end_in_a_sentence(clip, tmp_path, capsys) -> None:
    told = ["--pulled", str(clip.path), "--settings", str(tmp_path / "online.yaml"), "--output", str(tmp_path / "out")]
    for text, extra, sentence in (
        ("pins: pins.png\n", ["--estimator", "online"], "online.yaml names a file of pins, which is for infer.py"),
        ("speed: 1\n", ["--estimator", "online"], "has the unknown key 'speed'"),
        ("speed: 1\n", [], "is for --estimator online; leave it out"),
    ):
        (tmp_path / "online.yaml").write_text(text)
        with pytest.raises(SystemExit, match=r"^2$"):
            main([*told, *extra])
        assert sentence in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out").exists()
