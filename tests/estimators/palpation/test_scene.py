"""A scene's file: a surface or views of it, and what is wrong with it in a sentence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from palpate.data.source.layout import InputError
from palpate.estimators.palpation.scene import FEWEST, read_scene
from tests.estimators.palpation.test_views import RADII, views

PRESS = {"force": [0, 0, -1], "contact": [0, 0, 0.045], "points": "seen.csv"}


def write(folder: Path, **fields: object) -> Path:
    rows = [f"{number / 1000},0,0.04" for number in range(FEWEST)]
    (folder / "seen.csv").write_text("\n".join(["x,y,z", *rows]))
    scene = {"held_axis": "z", "held_below": -0.03, "cells": 6, "palpations": [PRESS]}
    (folder / "scene.yaml").write_text(yaml.safe_dump(scene | fields))
    return folder / "scene.yaml"


def write_views(folder: Path) -> list[dict[str, object]]:
    told = []
    for number, view in enumerate(views(0.0)[0]):
        rows = [f"v {x} {y} {z}" for x, y, z in view.vertices] + [f"f {a} {b} {c}" for a, b, c in view.triangles + 1]
        (folder / f"view{number}.obj").write_text("\n".join(rows))
        told.append({"surface": f"view{number}.obj", "pose": view.pose.tolist()})
    return told


def test_views_are_joined_and_the_body_is_held_at_its_floor(tmp_path: Path) -> None:
    scene = read_scene(write(tmp_path, views=write_views(tmp_path)))
    np.testing.assert_allclose(np.ptp(scene.skin.vertices, axis=0), 2 * RADII, rtol=0.1)
    assert scene.notes[0].startswith("6 views were joined; where they overlap they lie")
    rest = scene.skin.body.rest
    assert rest[:, 2].min() == pytest.approx(-0.03)
    np.testing.assert_array_equal(scene.held, np.repeat(rest[:, 2:] <= -0.03 + 1e-9, 3, axis=1))
    low = scene.skin.vertices[:, 2] <= -0.03
    moved = scene.skin.moved(np.ones_like(rest)) - scene.skin.vertices
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
