"""Small inputs of inference: parameter networks as ONNX files with the metadata of a real export, and drawn clips."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from palpate.data.contact.geometry import GeometrySettings
from palpate.data.depth.normalise import DepthSettings
from palpate.data.masks.request import MaskClasses
from palpate.data.settings import PREPROCESSING_VERSION
from palpate.models.onnx_session import EXPECTED_BOUND, FORMAT_VERSION, METADATA_KEY, POSTERIOR
from palpate.physics.mechanics import Bounds, Mechanics
from tests.networks import write_network

THETA = (0.5, 0.09, -0.4)
"""θ that `write_model` gives for a window of zero depth."""
SLOPE = (0.2, 0.0, 0.0)
"""What a window's mean depth adds to it."""


SIZE = (160, 96)
"""Width and height of the drawn frames [px]."""
GRID = (48, 80)
"""Height and width of the network's input."""
MEAN = {"axes": np.array([1, 2, 3]), "flat": np.array([-1, 1])}
"""Constants by which a batch of windows becomes a column of their means."""
TISSUE_COLOR, TOOL_COLOR, OTHER_COLOR = (255, 160, 165), (170, 255, 0), (127, 127, 127)


def metadata(window: int = 1, **changes: Any) -> dict[str, Any]:
    """The document of a model exported from default settings; `changes` replace whole sections."""
    geometry = changes.get("geometry", dataclasses.asdict(GeometrySettings(height=GRID[0], width=GRID[1])))
    document = {
        "format_version": FORMAT_VERSION,
        "preprocessing_version": PREPROCESSING_VERSION,
        "input": {"height": geometry["height"], "width": geometry["width"], "window": window},
        "bounds": dataclasses.asdict(Bounds(force=(-1.0, 0.0), initial=(0.5, 0.5, -0.5))),
        "units": {"stiffness": "scene units (normalised), not N/m", "force": "scene units; negative presses"},
        "mechanics": dataclasses.asdict(Mechanics(steps=40, load_steps=10)),
        "observation": "final",
        "geometry": geometry,
        "depth": dataclasses.asdict(DepthSettings()),
        "classes": dataclasses.asdict(MaskClasses()),
        "config_sha256": "0" * 64,
    }
    return document | changes


def write_model(
    path: Path,
    document: dict[str, Any] | None = None,
    *,
    theta: tuple[float, float, float] = THETA,
    slope: tuple[float, float, float] = SLOPE,
    inputs: tuple[str, ...] = ("depth",),
) -> Path:
    """Write a network that gives θ = theta + slope · (mean depth of the window)."""
    document = metadata() if document is None else document
    graph = f"""network ({", ".join(f"{_window(document)} {name}" for name in inputs)}) => (float[batch, 3] theta) {{
        mean = ReduceMean({inputs[0]}, axes)
        column = Reshape(mean, flat)
        scaled = MatMul(column, slope)
        theta = Add(scaled, offset)
    }}"""
    constants = {"slope": np.array([slope], np.float32), "offset": np.array([theta], np.float32)}
    return write_network(path, graph, _held(document), **constants, **MEAN)


def write_posterior(path: Path, document: dict[str, Any], features: int) -> Path:
    """Write a posterior whose mean depends on the depth window's mean and a little on the contact's vector."""
    graph = f"""network (float[batch, {features}] contact, {_window(document)} depth) =>
        (float[batch, 3] log_mean, float[batch, 3, 3] log_covariance, float[batch, 3, 3] {EXPECTED_BOUND}) {{
        mean = ReduceMean(depth, axes)
        column = Reshape(mean, flat)
        looked = MatMul(column, of_depth)
        felt = MatMul(contact, of_contact)
        log_mean = Sum(looked, felt, offset)
        empty = MatMul(column, nothing)
        row = Add(empty, spread)
        log_covariance = Reshape(row, square)
        {EXPECTED_BOUND} = Identity(log_covariance)
    }}"""
    return write_network(
        path,
        graph,
        _held(document | {"head": POSTERIOR}),
        of_depth=np.array([[-0.2, 0.1, 0.3]], np.float32),
        of_contact=np.random.default_rng(0).normal(0, 0.02, (features, 3)).astype(np.float32),
        offset=np.log([[0.4, 0.08, 0.1]]).astype(np.float32),
        nothing=np.zeros((1, 9), np.float32),
        spread=np.array([[0.2, 0.1, 0.1, 0.1, 0.3, 0.1, 0.1, 0.1, 0.4]], np.float32),
        square=np.array([-1, 3, 3]),
        **MEAN,
    )


def _window(document: dict[str, Any]) -> str:
    """Type of a batch of depth windows."""
    return f"float[batch, {', '.join(str(document['input'][name]) for name in ('window', 'height', 'width'))}]"


def _held(document: dict[str, Any]) -> dict[str, str]:
    return {METADATA_KEY: json.dumps(document)} if document else {}


def draw_frame(index: int, onset: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A tissue plane that a tool enters from above and touches from frame `onset` on, pressing it down.

    Returns:
        RGB image and colour mask, uint8 [H, W, 3], and depth uint16 [H, W].
    """
    width, height = SIZE
    noise = np.random.default_rng(3).integers(90, 190, (height // 4, width // 4, 3), np.uint8)
    image = cv2.resize(noise, SIZE, interpolation=cv2.INTER_CUBIC)
    mask = np.full((height, width, 3), OTHER_COLOR, np.uint8)
    top = 40
    mask[top:] = TISSUE_COLOR
    depth = np.full((height, width), 30000, np.uint16)
    depth[top:] = (26000 + 20 * np.arange(height - top))[:, None]
    tip = min(top + 4 * (index - onset) + 2, top + 14) if index >= onset else top - 24
    if index >= onset - 3:
        mask[:tip, 70:90] = TOOL_COLOR
        image[:tip, 70:90] = 220
        depth[:tip, 70:90] = 25500
    return image, mask, depth


def write_clip(folder: Path, frames: int = 8, onset: int = 4, *, first: int = 10) -> Path:
    """A folder in CholecSeg8k's layout with stored depth; the tool is in view from three frames before the onset."""
    folder.mkdir(parents=True)
    for index in range(frames):
        image, mask, depth = draw_frame(index, onset)
        stem = folder / f"frame_{first + index}_endo"
        for suffix, picture in (("", image), ("_color_mask", mask)):
            Path(f"{stem}{suffix}.png").write_bytes(encode(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)))
        Path(f"{stem}_depth.png").write_bytes(encode(depth))
    return folder


def write_video(path: Path, frames: int = 8, onset: int = 4, fps: float = 25.0) -> Path:
    """Write that clip's images as a video file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), fps, SIZE)
    for index in range(frames):
        writer.write(cv2.cvtColor(draw_frame(index, onset)[0], cv2.COLOR_RGB2BGR))
    writer.release()
    return path


def encode(picture: np.ndarray) -> bytes:
    """A picture as PNG."""
    return cv2.imencode(".png", picture)[1].tobytes()
