"""Where straight lines meet tissue, and what is wrong with some scenes."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from palpate.data.source.layout import InputError
from palpate.planning.scene import Placed, read_plan_scene
from tests.test_architecture import ROOT

SHIPPED = ROOT / "configs" / "scenes" / "two_curtains.yaml"
PIECE = Placed((1.0, 2.0), (1.0, 0.2), 90.0)


def test_clearance_of_a_turned_block() -> None:
    places = np.array([[1.0, 2.0], [1.3, 2.0], [1.0, 3.0], [1.1 + 0.3, 2.5 + 0.4]])
    np.testing.assert_allclose(PIECE.clearance(places), [-0.1, 0.2, 0.5, 0.5], atol=1e-12)
    np.testing.assert_allclose(PIECE.outside_frame(PIECE.inside_frame(places)), places, atol=1e-12)


def test_a_disc_touches_where_geometry_says() -> None:
    starts = np.array([[0.0, 2.0], [0.0, 2.0], [0.0, 2.6], [0.0, 2.55]])
    ends = np.array([[3.0, 2.0], [0.5, 2.0], [3.0, 2.6], [3.0, 2.55]])
    found = PIECE.met(starts, ends, 0.05 + 1e-3)
    assert found[0] == pytest.approx(0.9 - 0.051, abs=1e-4)
    assert np.isinf(found[[1, 2]]).all()
    assert found[3] == pytest.approx(0.9, abs=0.02)  # grazes the corner


def test_the_shipped_scene_is_read() -> None:
    scene = read_plan_scene(SHIPPED)
    assert [kind for kind, _ in scene.pieces] == ["curtain", "curtain"]
    assert scene.objects["curtain"].held == ("top",)
    # The tip fits between them.
    inner = [
        piece.outside_frame(np.array([side * piece.half[0], 0]))[0]
        for (_, piece), side in zip(scene.pieces, (1, -1), strict=True)
    ]
    assert 2 * scene.tip_radius < inner[1] - inner[0] < 4 * scene.tip_radius


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"alpha": 2}, "alpha is 2"),
        ({"tissue": [{"kind": "liver", "centre": [0, 0]}]}, "no object 'liver'"),
        ({"objects": {"curtain": {"size": [1, 1, 1], "young": -1}}}, r"young is -1; give 1 to 1e\+12"),
        ({"objects": {"curtain": {"size": [1, 1, 1e15], "young": 1e4}}}, "size is to be 0.0001 to 10 m"),
        ({"objects": {"curtain": {"size": [1, 1, 1], "young": 1e4, "cells": [40, 40, 40]}}}, "product 4000 at most"),
        ({"obstacles": [{"centre": [0, 0], "size": [0, 1]}]}, "size is not positive"),
        ({"goal": "there"}, "gives goal 'there'"),
    ],
)
def test_bad_scenes_are_a_sentence(tmp_path: Path, changed: dict[str, object], says: str) -> None:
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(yaml.safe_load(SHIPPED.read_text()) | changed))
    with pytest.raises(InputError, match=says):
        read_plan_scene(tmp_path / "scene.yaml")


def test_yaml_builds_no_objects(tmp_path: Path) -> None:
    (tmp_path / "scene.yaml").write_text("area: !!python/object/apply:os.getcwd []")
    with pytest.raises(InputError, match="is not a scene"):
        read_plan_scene(tmp_path / "scene.yaml")
