"""The door from forces to constants."""

import copy
import functools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from benchmarks.palpation import example
from benchmarks.palpation.example import scene_files
from benchmarks.palpation.synthetic import BODIES, observe, press
from palpate.cli import calibrate
from palpate.data.source.layout import InputError
from palpate.estimators.calibration_file import read_calibration
from palpate.estimators.palpation.bench import Palpation
from palpate.estimators.palpation.material_fit import MaterialFit
from palpate.estimators.palpation.skin import Skin
from palpate.physics.fem import Material, find_equilibrium


@functools.cache
def ball() -> tuple[dict[str, Any], str, str]:
    """The files of a pressed ball: scene, surface and points."""
    truth = press(BODIES["ball"], 0.8, (0.1, 0.5), 4, law="corotational")
    return scene_files(BODIES["ball"].surface(0.0035), observe(*truth, "stereo", 0, count=400), 0.012, 4)


def write_scene(folder: Path, **changed: object) -> Path:
    scene, surface, points = ball()
    (folder / "rest.obj").write_text(surface)
    (folder / "observed.csv").write_text(points)
    (folder / "scene.yaml").write_text(yaml.safe_dump(scene | changed))
    return folder / "scene.yaml"


def strict(path: Path) -> dict[str, Any]:
    def refuse(name: str) -> None:
        raise AssertionError(f"{name} in {path}")

    return json.loads(path.read_text(), parse_constant=refuse)


@pytest.mark.acceptance
def test_the_example_s_stiffness_is_found(tmp_path, capsys, monkeypatch):
    """From half the points and triangles."""
    monkeypatch.setattr(example, "POINTS", 2000)
    monkeypatch.setattr(example, "SPACING", 0.004)
    assert example.main(["--output", str(tmp_path / "example")]) == 0
    capsys.readouterr()
    assert calibrate.main(["palpation", str(tmp_path / "example" / "scene.yaml"), "--output", str(tmp_path)]) == 0
    record = strict(tmp_path / "calibration.json")
    assert record["young_pa"] == pytest.approx(example.YOUNG, rel=0.1)
    assert record["young_low_pa"] < example.YOUNG < record["young_high_pa"]
    assert record["poisson"] == pytest.approx(example.POISSON, abs=3 * record["poisson_sd"])
    assert record["verdict"] == "determined"
    assert capsys.readouterr().out.startswith("E = 1.0")
    errors = np.genfromtxt(tmp_path / "errors.csv", delimiter=",", names=True)["error_mm"]
    assert 0.1 < np.sqrt(np.nanmean(errors**2)) < 0.4
    assert np.isnan(errors).any()


@pytest.mark.slow
def test_a_reversed_force_is_a_sentence(tmp_path, capsys):
    right = ball()[0]["palpations"][0]
    turned = copy.deepcopy(right) | {"force": [-component for component in right["force"]]}
    scene = write_scene(tmp_path, palpations=[right, turned])
    assert calibrate.main(["palpation", str(scene), "--output", str(tmp_path / "out")]) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "scene.yaml: the force of palpation 2 points out of the body; give what the tool does to" in said
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())


def test_where_nothing_is_determined_no_number_is_given(tmp_path, capsys, monkeypatch):
    """A reversed force once gave 4.6 GPa, from nothing to infinity."""

    def fit(skin: Skin, held: np.ndarray, palpations: list[Palpation], *_: object, **__: object) -> MaterialFit:
        (each,) = palpations
        zero = np.zeros_like(skin.body.rest)
        rest = find_equilibrium(skin.body, Material("linear", 4.6e9, 0.3), held, forces=zero)
        return MaterialFit(4.6e9, 0.3, np.diag([1e6, 0.02]), [each.pose], [rest], 3e-4, 3)

    monkeypatch.setattr(calibrate, "fit_material", fit)
    assert calibrate.main(["palpation", str(write_scene(tmp_path)), "--output", str(tmp_path)]) == 0
    record = strict(tmp_path / "calibration.json")
    assert record["verdict"] == "nothing determined"
    assert (record["young_pa"], record["poisson"]) == (None, None)
    assert "young_low_pa" not in record
    said = capsys.readouterr().out
    assert said.startswith("nothing determined: the surface moved too little for points 0.3 mm off")
    with pytest.raises(InputError, match=r"calibration.json says that nothing is determined; press harder"):
        read_calibration(write_use(tmp_path))


def write_use(folder: Path) -> Path:
    (folder / "known.yaml").write_text("palpation: calibration.json\nthickness_m: 0.004\n")
    return folder / "known.yaml"


PRESS = {"contact": [0, 0, 0.1], "points": "observed.csv"}


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"surface": "none.obj"}, "none.obj is no .obj surface"),
        ({"cells": "many"}, "gives cells 'many'"),
        ({"held_below": -1.0}, "scene.yaml: 0 nodes lie below held_below"),
        ({"palpations": [PRESS | {"force": [0, 0, 0]}]}, "force is to be"),
        ({"palpations": [PRESS | {"force": [1e15, 0, 0]}]}, "1e-06 to 10000 N"),
        ({"cells": 64}, "cells is 64; give 2 to 24"),
        ({"held_below": 1e15}, "all of the surface lies below the floor at 1e+15 m"),
        ({"extra": 1}, "unknown key 'extra'"),
    ],
)
def test_bad_scenes_are_a_sentence(tmp_path, capsys, changed, says):
    scene = write_scene(tmp_path, **changed)
    assert calibrate.main(["palpation", str(scene), "--output", str(tmp_path / "out")]) == 1
    assert says in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("rows", "count"), [("", 0), ("0,0,0\n" * 11, 11), ("nan,0,0\n" * 50, 0)])
def test_a_surface_of_no_points_is_a_sentence(tmp_path, capsys, rows, count):
    scene = write_scene(tmp_path)
    (tmp_path / "observed.csv").write_text(f"x,y,z\n{rows}")
    assert calibrate.main(["palpation", str(scene), "--output", str(tmp_path / "out")]) == 1
    assert f"observed.csv holds {count} points; give 12 or more of the pressed surface" in capsys.readouterr().err
