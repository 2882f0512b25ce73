"""Judging forces in newtons: truths of clips, the door's table, and every clip known in turn."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest

from palpate.benchmarks import newtons
from palpate.benchmarks.newtons import MEASURED, NEWTONS, judge, measured_force, read_truths
from palpate.estimators.estimate import NINETY, NoEstimate

OFF = {"a": 0.0, "b": 0.1, "c": -0.3}
"""Of the logarithms of estimated forces; their standard deviation is told as SD."""
SD = 0.1


def write_clip(folder: Path, name: str, force: float, action: str = "press") -> None:
    (folder / name).mkdir(parents=True)
    truth = {"action": action, "theta": {"force": force}, "onset_s": 0.4, "release_s": 0.8}
    (folder / name / "truth.json").write_text(json.dumps(truth))


def write_row(path: Path, row: dict[str, object]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as stream:
        table = csv.DictWriter(stream, row)
        table.writeheader()
        table.writerow(row)


def judge_three(tmp_path: Path) -> dict[tuple[object, object], object]:
    for number, (name, off) in enumerate(OFF.items(), start=1):
        write_clip(tmp_path / "clips", name, -0.1 * number)
        force = 0.1 * number * math.exp(off)
        ends = {f"_{end}": math.exp(sign * NINETY * SD) for end, sign in (("low", -1), ("high", 1))}
        own = {"onset_frame": 7, "onset_time_s": 0.4, "verdict": "determined"}
        for quantity in ("stiffness", "damping", "force"):
            value = force if quantity == "force" else 0.5
            own |= {quantity: value} | {quantity + end: value * factor for end, factor in ends.items()}
        write_row(tmp_path / "results" / name / "interactions.csv", own)
        told = {"force": NEWTONS * force, "determined": "force"}
        told |= {f"force{end}": NEWTONS * force * factor ** math.sqrt(2) for end, factor in ends.items()}
        write_row(tmp_path / "results" / name / "calibrated.csv", told)
    rows = judge(tmp_path / "results", read_truths(tmp_path / "clips"), "a")
    return {(row["file"], name): value for row in rows for name, value in row.items()}


@pytest.fixture
def judged(tmp_path: Path) -> dict[tuple[object, object], object]:
    """Three clips, of which that of a is known; the table says the same as the estimates."""
    return judge_three(tmp_path)


def test_the_door_s_forces_are_compared_with_the_truth(judged: dict[tuple[object, object], object]) -> None:
    whole = "others, the force of a known"
    assert ("a", "force / truth - 1") not in judged
    assert judged["b", "force / truth - 1"] == pytest.approx(math.expm1(0.1))
    assert judged["c", "within the 90 % interval"] is False
    assert (judged[whole, "forces"], judged[whole, "determined"]) == (2, 2)
    assert judged[whole, "determined: within 20%"] == 0.5
    assert judged[whole, "determined: 90 % intervals hold"] == 0.5


def test_every_clip_s_force_is_known_in_turn(judged: dict[tuple[object, object], object], tmp_path: Path) -> None:
    """Errors are those of both estimates and of the sensor, and so are the intervals."""
    whole = "others, each clip's force known in turn"
    truths = read_truths(tmp_path / "clips")
    sensor = {name: math.log(measured_force(truth) / truth.force) for name, truth in truths.items()}
    off = np.array([OFF[j] - OFF[i] + sensor[i] for i in OFF for j in OFF if i != j])
    assert judged[whole, "forces"] == 6
    assert judged[whole, "determined: median error"] == pytest.approx(np.median(np.abs(np.expm1(off))), rel=1e-6)
    wide = NINETY * math.sqrt(2 * SD**2 + MEASURED**2)
    holds = np.abs(off) < wide
    assert judged[whole, "all: 90 % intervals hold"] == pytest.approx(holds.mean())
    # Without a: b and c; without b: a and c; without c: a and b.
    left = [holds[[3, 5]].mean(), holds[[1, 4]].mean(), holds[[0, 2]].mean()]
    spread = math.sqrt(2 / 3 * np.square(left - np.mean(left)).sum())
    assert 0 < spread == pytest.approx(judged[whole, "all: 90 % intervals hold, standard deviation"])


def test_pairs_that_all_share_a_clip_tell_no_spread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a alone gives a scale, leaving it out leaves no pair."""
    scale_by_force = newtons.scale_by_force

    def of_a_alone(runs: object, measured: object, mass: float, name: str) -> object:
        if name != "a":
            raise NoEstimate("none")
        return scale_by_force(runs, measured, mass, name)

    monkeypatch.setattr(newtons, "scale_by_force", of_a_alone)
    found = judge_three(tmp_path)
    whole = "others, each clip's force known in turn"
    assert found[whole, "forces"] == 2
    assert found[whole, "all: 90 % intervals hold"] == 0.5
    assert (whole, "all: 90 % intervals hold, standard deviation") not in found


def test_clips_without_a_press_of_known_force_are_left_out(tmp_path: Path) -> None:
    write_clip(tmp_path, "press", -0.2)
    write_clip(tmp_path, "grip", -0.2, action="grip")
    (found,) = read_truths(tmp_path).items()
    assert (found[0], found[1].force, found[1].known_time) == (
        "press",
        pytest.approx(NEWTONS * 0.2),
        pytest.approx(0.5),
    )
    assert read_truths(tmp_path / "none") == {}
