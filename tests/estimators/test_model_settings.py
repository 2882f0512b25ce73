"""Settings read back from an exported network's metadata, and what the user chooses otherwise."""

import dataclasses
from pathlib import Path
from typing import Any

import pytest

from palpate.data.contact.geometry import GeometrySettings
from palpate.data.depth.normalise import DepthSettings
from palpate.data.source.frames import InputError
from palpate.estimators.contract import Preparation
from palpate.estimators.gan import GanEstimator
from palpate.estimators.model_settings import check_sources, preparation_settings
from palpate.models.onnx_session import ModelFileError, ParameterModel
from tests.inference_inputs import GRID, metadata, write_model


def model_of(folder: Path, **changes: Any) -> ParameterModel:
    """A network whose metadata is changed so."""
    return ParameterModel(write_model(folder / "model.onnx", metadata() | changes))


def test_settings_come_from_the_model_unless_chosen(tmp_path: Path) -> None:
    geometry = GeometrySettings(height=GRID[0], width=GRID[1], contact_pixels=3.0)
    depth = DepthSettings(near=0.05, bits=8)
    model = model_of(tmp_path, geometry=dataclasses.asdict(geometry), depth=dataclasses.asdict(depth))
    assert preparation_settings(model, Preparation()).geometry == geometry
    assert preparation_settings(model, Preparation(device="cpu")).depth == depth
    assert preparation_settings(model, Preparation()).masks == "auto"
    chosen = preparation_settings(model, Preparation(masks="automatic", depth="stored"))
    assert chosen.depth == dataclasses.replace(depth, source="stored", device="auto")
    assert chosen.masks == "automatic"


@pytest.mark.parametrize(("trained", "expected"), [("annotation", "auto"), ("automatic", "automatic")])
def test_masks_are_the_models_where_a_clip_without_annotation_has_them(tmp_path, trained, expected) -> None:
    model = model_of(tmp_path, masks=trained, bridge_frames=5, track_seconds=2.0)
    settings = preparation_settings(model, Preparation())
    assert (settings.masks, settings.bridge_frames, settings.track_seconds) == (expected, 5, 2.0)
    assert preparation_settings(model, Preparation(masks="annotation")).masks == "annotation"


def test_model_files_of_the_training_are_asked_for(tmp_path: Path) -> None:
    depth = {"source": "net.onnx", "preset": "midas-small"}
    model = model_of(tmp_path, depth=depth, masks="seg.onnx")
    with pytest.raises(ModelFileError, match=r"trained with depth from net\.onnx; give that file as --depth"):
        preparation_settings(model, Preparation())
    with pytest.raises(ModelFileError, match=r"trained with masks from seg\.onnx; give that file as --masks"):
        preparation_settings(model, Preparation(depth="elsewhere/net.onnx"))
    same = preparation_settings(model, Preparation(masks="auto", depth="elsewhere/net.onnx"))
    other = preparation_settings(model, Preparation(masks="auto", depth="elsewhere/other.onnx"))
    assert (same.depth.preset, other.depth.preset) == ("midas-small", None)
    model = model_of(tmp_path, depth={"source": "depthpro", "model": "net.onnx"})
    assert preparation_settings(model, Preparation(depth="stored")).depth.model is None


GRID_SETTINGS = {"height": GRID[0], "width": GRID[1]}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"geometry": GRID_SETTINGS | {"wobble": 1}}, "'geometry' of its metadata, has the unknown key 'wobble'"),
        ({"depth": {"near": -1.0}}, "'depth' of its metadata, can't be used"),
        ({"mechanics": {"mass": 0}}, "'mechanics' of its metadata, can't be used"),
        ({"observation": "guess"}, "was trained with observation guess"),
        ({"geometry": GRID_SETTINGS | {"keep": "all"}}, "'geometry' of its metadata, gives keep 'all'; give a number"),
        ({"geometry": GRID_SETTINGS | {"smoothing": 1e8}}, r"can't be used: geometry\.smoothing is 100000000"),
        ({"geometry": GRID_SETTINGS | {"keep": 1e-9}}, r"can't be used: geometry\.keep is 1e-09"),
        ({"depth": {"scale": [1.0]}}, r"gives scale \[1\.0\]"),
        ({"classes": {"tool": "grasper"}}, "gives tool 'grasper'"),
        ({"bridge_frames": -1}, "can't be used: bridge_frames is -1"),
        ({"track_seconds": -1}, "can't be used: track_seconds is -1"),
        ({"mechanics": {"steps": 200.5}}, r"gives steps 200\.5"),
        ({"mechanics": {"steps": 10**8}}, r"can't be used: mechanics\.steps is 100000000; give 1 to 20000"),
        ({"bounds": {"initial": [0.5, 0.5]}}, r"gives initial \[0\.5, 0\.5\]"),
        ({"geometry": {"height": 50, "width": 80}}, r"takes \(48, 80\) but its geometry gives \(50, 80\)"),
    ],
)
def test_metadata_that_cannot_be_used_is_named(tmp_path: Path, changes: dict, words: str) -> None:
    model = model_of(tmp_path, **changes)

    def use() -> None:
        preparation_settings(model, Preparation())
        GanEstimator(model)

    with pytest.raises(ModelFileError, match=words) as caught:
        use()
    assert "model.onnx" in str(caught.value)


def test_sources_are_checked_before_any_work(tmp_path: Path) -> None:
    model = model_of(tmp_path)
    check_sources(preparation_settings(model, Preparation()))
    with pytest.raises(InputError, match="masks 'wishful' is unknown"):
        check_sources(preparation_settings(model, Preparation(masks="wishful")))
    with pytest.raises(InputError, match=r"nowhere\.onnx"):
        check_sources(preparation_settings(model, Preparation(depth="nowhere.onnx")))
