"""Settings read back from an exported network's metadata, and what the user chooses otherwise."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from data.depth import DepthSettings
from data.frames import InputError
from data.geometry import GeometrySettings
from estimators.amortized import AmortizedEstimator
from estimators.model_settings import check_sources, preparation_settings
from models.onnx_session import ModelFileError, ParameterModel
from tests.inference_inputs import GRID, metadata, write_model


def test_settings_come_from_the_model_unless_chosen(tmp_path: Path) -> None:
    geometry = GeometrySettings(height=GRID[0], width=GRID[1], contact_pixels=3.0)
    depth = DepthSettings(near=0.05, bits=8)
    document = metadata(geometry=dataclasses.asdict(geometry), depth=dataclasses.asdict(depth))
    model = ParameterModel(write_model(tmp_path / "model.onnx", document))
    assert preparation_settings(model).geometry == geometry
    assert preparation_settings(model).depth == depth
    assert preparation_settings(model).masks == "auto"
    chosen = preparation_settings(model, masks="automatic", depth={"source": "stored"})
    assert chosen.depth == dataclasses.replace(depth, source="stored")
    assert chosen.masks == "automatic"


@pytest.mark.parametrize(
    ("trained", "expected"), [("auto", "auto"), ("annotation", "auto"), ("automatic", "automatic")]
)
def test_masks_are_the_models_where_a_clip_without_annotation_has_them(
    tmp_path: Path, trained: str, expected: str
) -> None:
    document = metadata(masks=trained, bridge_frames=5, track_seconds=2.0)
    model = ParameterModel(write_model(tmp_path / "model.onnx", document))
    settings = preparation_settings(model)
    assert (settings.masks, settings.bridge_frames, settings.track_seconds) == (expected, 5, 2.0)
    assert preparation_settings(model, masks="annotation").masks == "annotation"


def test_model_files_of_the_training_are_asked_for(tmp_path: Path) -> None:
    depth = {"source": "net.onnx", "preset": "midas-small"}
    model = ParameterModel(write_model(tmp_path / "model.onnx", metadata(depth=depth, masks="seg.onnx")))
    with pytest.raises(ModelFileError, match=r"trained with depth from net\.onnx; give that file's path as --depth"):
        preparation_settings(model)
    with pytest.raises(ModelFileError, match=r"trained with masks from seg\.onnx; give that file's path as --masks"):
        preparation_settings(model, depth={"source": "elsewhere/net.onnx"})
    same = preparation_settings(model, masks="auto", depth={"source": "elsewhere/net.onnx"})
    other = preparation_settings(model, masks="auto", depth={"source": "elsewhere/other.onnx"})
    assert (same.depth.preset, other.depth.preset) == ("midas-small", None)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"geometry": {"height": 48, "width": 80, "wobble": 1}}, "unknown setting 'geometry.wobble'"),
        ({"depth": {"near": -1.0}}, "unusable settings in 'depth'"),
        ({"mechanics": {"mass": 0}}, "unusable settings in 'mechanics'"),
        ({"observation": "guess"}, "unknown observation 'guess'"),
    ],
)
def test_metadata_that_cannot_be_used_is_named(tmp_path: Path, changes: dict, words: str) -> None:
    model = ParameterModel(write_model(tmp_path / "model.onnx", metadata(**changes)))

    def use() -> None:
        preparation_settings(model)
        AmortizedEstimator(model)

    with pytest.raises(ModelFileError, match=words) as caught:
        use()
    assert "model.onnx" in str(caught.value)


def test_geometry_that_contradicts_the_input_is_refused(tmp_path: Path) -> None:
    document = metadata() | {"geometry": dataclasses.asdict(GeometrySettings(height=50, width=80))}
    with pytest.raises(ModelFileError, match=r"takes \(48, 80\) but its geometry gives \(50, 80\)"):
        preparation_settings(ParameterModel(write_model(tmp_path / "model.onnx", document)))


def test_sources_are_checked_before_any_work(tmp_path: Path) -> None:
    model = ParameterModel(write_model(tmp_path / "model.onnx"))
    check_sources(preparation_settings(model))
    with pytest.raises(InputError, match="masks 'wishful' is unknown"):
        check_sources(preparation_settings(model, masks="wishful"))
    with pytest.raises(InputError, match=r"nowhere\.onnx"):
        check_sources(preparation_settings(model, depth={"source": "nowhere.onnx"}))
