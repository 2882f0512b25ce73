"""A scene's file: a surface or views of it, and what is wrong with it in a sentence."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial import ConvexHull

from palpate.data.source.layout import InputError
from palpate.estimators.palpation import scene
from palpate.estimators.palpation.scene import FEWEST, read_scene
from palpate.physics.fem import NoBody
from tests.estimators.palpation.test_registration import RADII, views

PRESS = {"force": [0, 0, -1], "contact": [0, 0, 0.045], "points": "seen.csv"}


def write(folder: Path, **fields: object) -> Path:
    rows = [f"{number / 1000},0,0.04" for number in range(FEWEST)]
    (folder / "seen.csv").write_text("\n".join(["x,y,z", *rows]))
    values = {"held_axis": "z", "held_below": -0.03, "cells": 6, "palpations": [PRESS]}
    (folder / "scene.yaml").write_text(yaml.safe_dump(values | fields))
    return folder / "scene.yaml"


def write_surface(path: Path, nodes: np.ndarray, faces: np.ndarray) -> None:
    rows = [f"v {x} {y} {z}" for x, y, z in nodes] + [f"f {a} {b} {c}" for a, b, c in faces + 1]
    path.write_text("\n".join(rows))


def write_slab(folder: Path, unit: float = 1.0, **fields: object) -> Path:
    """Ten centimetres in length, in so many units a metre."""
    nodes = unit * np.array([[x, y, z] for x in (0, 0.1) for y in (0, 0.06) for z in (0, 0.03)])
    write_surface(folder / "slab.obj", nodes, ConvexHull(nodes).simplices)
    return write(folder, surface="slab.obj", **{"held_below": 0.001} | fields)


def test_views_are_joined_and_the_body_is_held_at_its_floor(tmp_path: Path) -> None:
    told = []
    for number, view in enumerate(views(0.0)[0]):
        write_surface(tmp_path / f"view{number}.obj", view.vertices, view.triangles)
        told.append({"surface": f"view{number}.obj", "pose": view.pose.tolist()})
    found = read_scene(write(tmp_path, views=told))
    np.testing.assert_allclose(np.ptp(found.skin.vertices, axis=0), 2 * RADII, rtol=0.1)
    assert found.notes[0].startswith("6 views were joined; where they overlap they lie")
    rest = found.skin.body.rest
    assert rest[:, 2].min() == pytest.approx(-0.03)
    np.testing.assert_array_equal(found.held, np.repeat(rest[:, 2:] <= -0.03 + 1e-9, 3, axis=1))
    low = found.skin.vertices[:, 2] <= -0.03
    moved = found.skin.moved(np.ones_like(rest)) - found.skin.vertices
    np.testing.assert_allclose(moved[low], 0, atol=1e-12)
    np.testing.assert_allclose(moved[~low], 1, atol=1e-12)


@pytest.mark.parametrize(
    ("fields", "told"),
    [
        ({}, "surface and views both show the body at rest; give one of them."),
        ({"surface": "a.obj", "views": [{"surface": "a.obj"}]}, "give one of them."),
        ({"views": [{"pose": np.eye(4).tolist()}]}, "view 1 lacks 'surface'"),
        ({"views": [{"surface": "a.obj", "pose": (2 * np.eye(4)).tolist()}]}, "pose is no rotation and shift"),
        ({"views": [{"surface": "none.obj"}]}, "none.obj is no .obj surface"),
    ],
)
def test_what_is_wrong_is_said_in_a_sentence(tmp_path: Path, fields: dict[str, object], told: str) -> None:
    with pytest.raises(InputError) as error:
        read_scene(write(tmp_path, **fields))
    assert told in str(error.value)
    assert "\n" not in str(error.value)


ROW = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 300], [0, 0, 0, 1]]


@pytest.mark.parametrize(
    ("unit", "fields", "told"),
    [
        (1000, {}, "slab.obj, 100 m wide, looks like millimetres;"),
        (100, {}, "slab.obj, 10 m wide, looks like millimetres or centimetres;"),
        (1, {"held_below": 12}, "scene.yaml: held_below, 12, looks like millimetres;"),
        (1, {"thickness": 30}, "scene.yaml: thickness, 30, looks like millimetres;"),
        (1, {"palpations": [PRESS | {"tool_radius": 15}]}, "palpation 1: tool_radius, 15, looks like millimetres;"),
        (1, {"palpations": [PRESS | {"hole": 17.5}]}, "palpation 1: hole, 17.5, looks like millimetres;"),
        (1, {"palpations": [PRESS | {"pose_shift": 50}]}, "pose_shift, 50, looks like millimetres or centimetres;"),
        (1, {"palpations": [PRESS | {"pose": ROW}]}, "the shift of pose, 300, looks like millimetres or centimetres;"),
        (1, {"palpations": [PRESS | {"contact": [50, 30, 30]}]}, "contact, [50, 30, 30], looks like millimetres;"),
        (1, {"palpations": [PRESS | {"points": "far.csv"}]}, "far.csv, 98.1 m wide, looks like millimetres;"),
    ],
)
def test_lengths_in_other_units_are_named_before_anything_is_meshed(unit, fields, told, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(scene, "mesh_surface", lambda *_, **__: pytest.fail("meshed"))
    (tmp_path / "far.csv").write_text("\n".join(["x,y,z", *(f"{x},0,40" for x in range(-5, 105))]))
    with pytest.raises(InputError) as error:
        read_scene(write_slab(tmp_path, unit, **fields))
    assert told in str(error.value)
    assert str(error.value).endswith("; give all lengths of the scene in metres.")


@pytest.mark.parametrize("fields", [{}, {"held_below": -0.02}, {"palpations": [PRESS | {"contact": [0.1, 0.1, 0.2]}]}])
def test_lengths_in_metres_are_meshed(fields, tmp_path, monkeypatch) -> None:
    def mesh(*_: object, **__: object) -> None:
        raise NoBody("meshed")

    monkeypatch.setattr(scene, "mesh_surface", mesh)
    with pytest.raises(InputError, match=r"slab.obj: meshed"):
        read_scene(write_slab(tmp_path, **fields))
