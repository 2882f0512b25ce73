"""A scene's file, and what is wrong with it in a sentence."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial import ConvexHull

from palpate.data.source.layout import InputError
from palpate.estimators.palpation.scene import FEWEST, read_scene

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
    return write(folder, **{"surface": "slab.obj", "held_below": 0.001} | fields)


POSE = np.eye(4).tolist()


@pytest.mark.parametrize(
    ("unit", "fields", "told"),
    [
        (1, {"views": []}, "scene.yaml has the unknown key 'views'"),
        (1, {"surface": "none.obj"}, "none.obj is no .obj surface"),
        (1, {"palpations": [PRESS | {"pose": (2 * np.eye(4)).tolist()}]}, "pose is no rotation and shift"),
        (1, {"palpations": [PRESS | {"pose": [*POSE[:2], [0, 0, 1, 300], POSE[3]]}]}, "4 × 4 matrix, in metres."),
        (1, {"palpations": [PRESS | {"tool_radius": 15}]}, "are to be positive, lengths in metres."),
        (1, {"palpations": [PRESS | {"points": "far.csv"}]}, "far.csv is 98.1 m wide; give all lengths"),
        (1, {"held_below": 12}, "all of the surface lies below the floor at 12 m"),
        (1000, {}, "slab.obj is 100 m wide; give all lengths of the scene in metres."),
    ],
)
def test_what_is_wrong_is_said_in_a_sentence(tmp_path: Path, unit: float, fields: dict, told: str) -> None:
    (tmp_path / "far.csv").write_text("\n".join(["x,y,z", *(f"{x},0,40" for x in range(-5, 105))]))
    with pytest.raises(InputError) as error:
        read_scene(write_slab(tmp_path, unit, **fields))
    assert told in str(error.value)
    assert "\n" not in str(error.value)


def test_the_body_is_held_at_its_floor(tmp_path: Path) -> None:
    found = read_scene(write_slab(tmp_path, palpations=[PRESS | {"contact": [0.05, 0.03, 0.03]}]))
    rest = found.skin.body.rest
    assert rest[:, 2].min() == pytest.approx(0.001)
    np.testing.assert_array_equal(found.held, np.repeat(rest[:, 2:] <= 0.001 + 1e-9, 3, axis=1))
    low = found.skin.vertices[:, 2] <= 0.001
    moved = found.skin.moved(np.ones_like(rest)) - found.skin.vertices
    np.testing.assert_allclose(moved[low], 0, atol=1e-12)
    np.testing.assert_allclose(moved[~low], 1, atol=1e-12)
