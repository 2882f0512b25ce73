"""Judging forces in newtons: truths of clips, and the door's table."""

import csv
import json
import math
from pathlib import Path

import pytest

from palpate.benchmarks.newtons import NEWTONS, judge, read_truths
from palpate.estimators.estimate import NINETY

OFF = {"a": 0.0, "b": 0.1, "c": -0.3}
"""Of the logarithms of estimated forces; their standard deviation is told as SD."""
SD = 0.14


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


@pytest.fixture
def judged(tmp_path: Path) -> dict[tuple[object, object], object]:
    """Three clips, of which that of a is known."""
    for number, (name, off) in enumerate(OFF.items(), start=1):
        write_clip(tmp_path / "clips", name, -0.1 * number)
        force = 0.1 * NEWTONS * number * math.exp(off)
        ends = {f"force{end}": force * math.exp(sign * NINETY * SD) for end, sign in (("_low", -1), ("_high", 1))}
        write_row(tmp_path / "results" / name / "calibrated.csv", {"force": force, "determined": "force", **ends})
    rows = judge(tmp_path / "results", read_truths(tmp_path / "clips"), "a")
    return {(row["file"], name): value for row in rows for name, value in row.items()}


def test_the_door_s_forces_are_compared_with_the_truth(judged: dict[tuple[object, object], object]) -> None:
    whole = "others, the force of a known"
    assert ("a", "force / truth - 1") not in judged
    assert judged["b", "force / truth - 1"] == pytest.approx(math.expm1(0.1))
    assert judged["c", "within the 90 % interval"] is False
    assert (judged[whole, "forces"], judged[whole, "determined"]) == (2, 2)
    assert judged[whole, "determined: within 20%"] == 0.5
    assert judged[whole, "determined: 90 % intervals hold"] == 0.5


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
