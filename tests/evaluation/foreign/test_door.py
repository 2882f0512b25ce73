"""The door judges what it knows, and one bad file doesn't end the batch."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from palpate.evaluation.foreign import __main__ as door
from tests.evaluation.foreign.pulls import write_beam, write_pull


def table(folder: Path) -> dict[tuple[str, str], str]:
    with (folder / "table.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["file", "measure", "value"]
    return {(row["file"], row["measure"]): row["value"] for row in rows}


def test_every_file_gets_its_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = tmp_path / "data"
    write_pull(data / "liver", "linear")
    (data / "liver" / "linear_bad.npz").write_bytes(b"none")
    write_beam(data / "beam" / "beam_gravity_a.csv", 7.7, 2.5)
    write_beam(data / "beam" / "beam_load52_a.csv", 4.3, 1.5)
    write_beam(data / "beam" / "beam_load101_a.csv", 3.3, 1.1)
    (data / "beam" / "beam_load20.csv").write_text("nothing")
    monkeypatch.setattr("palpate.evaluation.foreign.beam.MESHES", ((4, 1, 1), (8, 2, 2)))
    assert door.main(["--data", str(data), "--output", str(tmp_path / "out")]) == 1
    found = table(tmp_path / "out")
    assert float(found["liver/linear_s1.npz", "force error, median where above 1 N"]) < 1e-4
    assert "linear_bad.npz" in found["liver/linear_bad.npz", "status"]
    assert "beam_load20.csv" in found["beam/beam_load20.csv", "status"]
    assert abs(float(found["beam/beam_load101_a.csv", "frequency error"])) < 0.1
    assert ("beam, fitted together", "E (Pa)") in found


def test_an_unexpected_error_costs_one_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("linear_a.npz", "linear_b.npz"):
        (tmp_path / name).touch()

    def judge(path: Path) -> dict[str, object]:
        if path.name == "linear_a.npz":
            raise ZeroDivisionError("by nothing")
        return {"frames": 3}

    monkeypatch.setattr(door, "judge_pull", judge)
    assert door.main(["--data", str(tmp_path), "--output", str(tmp_path / "out")]) == 1
    found = table(tmp_path / "out")
    assert found["linear_a.npz", "status"] == "failed (ZeroDivisionError: by nothing)"
    assert found["linear_b.npz", "frames"] == "3"


def test_nothing_known_is_wrong_usage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        door.main(["--data", str(tmp_path), "--output", str(tmp_path / "out")])
    assert "holds none of" in capsys.readouterr().err
