"""The door from forces to constants."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from palpate.command import calibrate
from palpate.evaluation.palpation.synthetic import BODIES, TOOL, observe, press
from tests.evaluation.palpation.test_door import write_hold, write_probes


def write_scene(folder: Path, edge: float | None = None, **changed: object) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    truth = press(BODIES["ball"], 1e4, 0.42, 0.8, (0.1, 0.5), 5, law="corotational", edge=edge)
    seen = observe(*truth, "stereo", 0, count=600)
    vertices, triangles = BODIES["ball"].surface(0.0035)
    rows = [f"v {x} {y} {z}" for x, y, z in vertices] + [f"f {a} {b} {c}" for a, b, c in triangles + 1]
    (folder / "rest.obj").write_text("\n".join(rows))
    (folder / "seen.csv").write_text("x,y,z\n" + "\n".join(",".join(map(str, point)) for point in seen.points))
    palpation = {
        "force": seen.force.tolist(),
        "contact": seen.contact.tolist(),
        "points": "seen.csv",
        "pose": seen.pose.tolist(),
        "tool_radius": TOOL,
        "hole": 1.1 * TOOL,
    }
    scene = {"surface": "rest.obj", "held_axis": "z", "held_below": 0.012, "cells": 5, "palpations": [palpation]}
    (folder / "scene.yaml").write_text(yaml.safe_dump(scene | changed))
    return folder / "scene.yaml"


@pytest.mark.slow
def test_a_palpation_becomes_a_modulus(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = write_scene(tmp_path, 0.6 * TOOL)  # a truth on plain cells lies half a millimetre off the surface
    assert calibrate.main(["palpation", str(scene), "--output", str(tmp_path / "out")]) == 0
    record = json.loads((tmp_path / "out" / "calibration.json").read_text())
    assert record["young_pa"] == pytest.approx(1e4, rel=0.2)
    assert record["young_low_pa"] < record["young_pa"] < record["young_high_pa"]
    assert record["verdict"] in ("determined", "young")
    assert "Pa" in capsys.readouterr().out
    errors = np.genfromtxt(tmp_path / "out" / "errors.csv", delimiter=",", names=True)["error_mm"]
    assert 0.1 < np.sqrt(np.nanmean(errors**2)) < 1
    assert np.isnan(errors).any()


def test_curves_say_what_their_numbers_are(tmp_path: Path) -> None:
    write_probes(tmp_path / "probes.csv")
    write_hold(tmp_path / "hold.csv")
    files = [str(tmp_path / "probes.csv"), str(tmp_path / "hold.csv")]
    for more, unit in (([], "N/mm"), (["--indenter", "sphere", "--size", "3"], "kPa")):
        assert calibrate.main(["curves", *files, *more, "--output", str(tmp_path / "out")]) == 0
        with (tmp_path / "out" / "curves.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        probes = [row for row in rows if row["file"] == "probes.csv"]
        assert {row["unit"] for row in probes} == {unit}
        assert all(float(row["low"]) < float(row["value"]) < float(row["high"]) for row in probes)
        (time,) = [row for row in rows if row["quantity"] == "relaxation time"]
        assert float(time["value"]) == pytest.approx(2.0, rel=0.05)


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"surface": "none.obj"}, "none.obj is no .obj surface"),
        ({"cells": "many"}, "gives cells 'many'"),
        ({"held_below": -1.0}, "0 nodes lie below held_below"),
        ({"palpations": [{"force": [0, 0, 0], "contact": [0, 0, 0.1], "points": "seen.csv"}]}, "force is to be"),
        ({"palpations": [{"force": [1e15, 0, 0], "contact": [0, 0, 0.1], "points": "seen.csv"}]}, "1e-06 to 10000 N"),
        ({"cells": 64}, "cells is 64; give 2 to 24"),
        ({"young": 1e-300}, "young is to be 1 to 1e+12 Pa"),
        ({"held_below": 1e15}, "all of the surface lies below the floor at 1e+15 m"),
        ({"extra": 1}, "unknown key 'extra'"),
    ],
)
def test_bad_scenes_are_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], changed: dict[str, object], says: str
) -> None:
    scene = write_scene(tmp_path, **changed)
    assert calibrate.main(["palpation", str(scene), "--output", str(tmp_path / "out")]) == 1
    assert says in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("rows", ["", "0,0,0\n" * 11, "nan,0,0\n" * 50])
def test_a_surface_of_no_points_is_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str], rows: str) -> None:
    scene = write_scene(tmp_path)
    (tmp_path / "seen.csv").write_text(f"x,y,z\n{rows}")
    assert calibrate.main(["palpation", str(scene), "--output", str(tmp_path / "out")]) == 1
    told = capsys.readouterr().err
    assert f"seen.csv holds {len(rows) // 6 if rows[:1] == '0' else 0} points; give the surface as it was seen" in told


def test_an_indenter_needs_its_size(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="2"):
        calibrate.main(["curves", "a.csv", "--indenter", "sphere", "--output", str(tmp_path)])
