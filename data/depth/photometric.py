"""A depth model that needs no training: brightness under a light at the camera, as a small ONNX graph.

In an endoscope the light sits beside the lens, so a matt surface of albedo ρ at the distance R along its ray sends back
I ∝ ρ·cosθ/R², θ being the angle between its normal and the ray. With R = z/cosα, where α is the ray's angle to the
optical axis, and a surface parallel to the image plane (θ = α), z = cos^1.5(α)·sqrt(ρ/I): relative depth for one albedo
and one exposure.

`python -m data.depth.photometric` writes the file that is shipped beside this module.
"""

from __future__ import annotations

from physics.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import argparse
import math
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from physics.files import replacing

SHIPPED = Path(__file__).with_name("photometric.onnx")
RED, GREEN = 0.7, 0.3
"""Weights of the linear channels. Blood absorbs green and blue, so red varies least with albedo; green helps where red
saturates."""
WINDOW = 9
"""Window of the morphological filters [px of the network's input, 428 wide]: highlights and vessels are narrower."""
TOLERANCE = 1.2
"""Factor by which brightness may differ from the filtered one before it is pulled to it."""
SIGMA = 6.0
"""Standard deviation of the smoothing [px of the network's input]."""
DARKEST = 0.005
"""Linear brightness (white = 1) under which sensor noise decides: such pixels are invalid (15 of 255 in sRGB)."""


class _Graph:
    """Collects nodes and constants; every call returns the name of its result."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []

    def constant(self, value: float | list[int] | np.ndarray, dtype: type = np.float32) -> str:
        name = f"c{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.asarray(value, dtype), name))
        return name

    def node(self, kind: str, *inputs: str | float, **attributes: Any) -> str:
        names = [item if isinstance(item, str) else self.constant(item) for item in inputs]
        name = f"n{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, names, [name], name=f"{kind.lower()}_{name}", **attributes))
        return name


def build_photometric(field_of_view_deg: float = 60.0) -> onnx.ModelProto:
    """The model: input `image` [1, 3, H, W] sRGB in [0, 1], output `depth` [1, H, W], relative, 0 = too dark.

    Every pixel is treated alike in every frame; nothing is normalised by the frame, so a change of exposure shows as a
    change of depth.

    Args:
        field_of_view_deg: horizontal field of view of the camera [degrees].

    Raises:
        ValueError: the field of view is not between 0 and 180 degrees.
    """
    if not 0 < field_of_view_deg < 180:
        raise ValueError(f"The field of view is {field_of_view_deg}; give degrees between 0 and 180.")
    graph = _Graph()
    brightness = _smooth(graph, *_despeckle(graph, _luminance(graph)))
    cosine = _ray_cosine(graph, math.tan(math.radians(field_of_view_deg) / 2))
    lit = graph.node("Greater", brightness, DARKEST)
    distance = graph.node("Reciprocal", graph.node("Sqrt", graph.node("Max", brightness, DARKEST)))
    depth = graph.node("Mul", graph.node("Pow", cosine, 1.5), distance)
    kept = graph.node("Where", lit, depth, 0.0)
    graph.nodes.append(helper.make_node("Squeeze", [kept, graph.constant([1], np.int64)], ["depth"], name="output"))
    model = helper.make_model(
        helper.make_graph(
            graph.nodes,
            "photometric_depth",
            [helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 3, "height", "width"])],
            [helper.make_tensor_value_info("depth", TensorProto.FLOAT, [1, "height", "width"])],
            graph.constants,
        ),
        opset_imports=[helper.make_opsetid("", 18)],
        ir_version=9,
        producer_name="palpate",
    )
    onnx.checker.check_model(model, full_check=True)
    return model


def _luminance(graph: _Graph) -> str:
    """Linear brightness [1, 1, H, W]: sRGB undone (IEC 61966-2-1), red and green weighted."""
    low = graph.node("Div", "image", 12.92)
    high = graph.node("Pow", graph.node("Div", graph.node("Add", "image", 0.055), 1.055), 2.4)
    linear = graph.node("Where", graph.node("LessOrEqual", "image", 0.04045), low, high)
    return graph.node("Conv", linear, graph.constant(np.array([RED, GREEN, 0.0]).reshape(1, 3, 1, 1)))


def _despeckle(graph: _Graph, brightness: str) -> tuple[str, str]:
    """Brightness with narrow highlights (opening) and narrow dark lines (closing) pulled in, and where it is usable."""

    def pool(name: str) -> str:
        return graph.node("MaxPool", name, kernel_shape=[WINDOW, WINDOW], pads=[WINDOW // 2] * 4)

    def negative_pool(name: str) -> str:
        return graph.node("Neg", pool(graph.node("Neg", name)))

    opened = pool(negative_pool(brightness))
    filtered = negative_pool(pool(opened))
    upper = graph.node("Min", brightness, graph.node("Mul", filtered, TOLERANCE))
    limited = graph.node("Max", upper, graph.node("Div", filtered, TOLERANCE))
    usable = graph.node("Cast", graph.node("Greater", limited, DARKEST), to=TensorProto.FLOAT)
    return limited, usable


def _smooth(graph: _Graph, brightness: str, usable: str) -> str:
    """Gaussian mean over usable pixels only (normalised convolution, also at the picture's border); 0 elsewhere."""
    radius = math.ceil(3 * SIGMA)
    weights = np.exp(-0.5 * (np.arange(-radius, radius + 1) / SIGMA) ** 2)
    weights /= weights.sum()

    def blur(name: str) -> str:
        down = graph.constant(weights.reshape(1, 1, -1, 1))
        across = graph.constant(weights.reshape(1, 1, 1, -1))
        vertical = graph.node("Conv", name, down, pads=[radius, 0, radius, 0])
        return graph.node("Conv", vertical, across, pads=[0, radius, 0, radius])

    total = blur(graph.node("Mul", brightness, usable))
    share = graph.node("Max", blur(usable), 1e-6)
    return graph.node("Mul", graph.node("Div", total, share), usable)


def _ray_cosine(graph: _Graph, half_width: float) -> str:
    """cosα of every pixel's ray to the optical axis [1, 1, H, W]; `half_width` is tan(field of view / 2)."""
    height, width = (graph.node("Shape", "image", start=axis, end=axis + 1) for axis in (2, 3))
    # Pixels span half_width from the centre to the left and right edges; pixels are square.
    width_px = graph.node("Cast", width, to=TensorProto.FLOAT)
    pitch = graph.node("Div", 2 * half_width, width_px)

    def squares(size: str, shape: list[int]) -> str:
        scalar = graph.node("Squeeze", size)
        indices = graph.node("Range", graph.constant(0, np.int64), scalar, graph.constant(1, np.int64))
        centred = graph.node(
            "Sub",
            graph.node("Cast", indices, to=TensorProto.FLOAT),
            graph.node("Div", graph.node("Sub", graph.node("Cast", size, to=TensorProto.FLOAT), 1.0), 2.0),
        )
        slope = graph.node("Reshape", graph.node("Mul", centred, pitch), graph.constant(shape, np.int64))
        return graph.node("Mul", slope, slope)

    offsets = graph.node("Add", squares(height, [1, 1, -1, 1]), squares(width, [1, 1, 1, -1]))
    return graph.node("Reciprocal", graph.node("Sqrt", graph.node("Add", offsets, 1.0)))


def write_photometric(path: Path, field_of_view_deg: float = 60.0) -> None:
    """Write the model to a file (under a temporary name first)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as partial:
        onnx.save(build_photometric(field_of_view_deg), str(partial))


def main() -> None:
    """Write the model, e.g. for an endoscope with another field of view."""
    parser = argparse.ArgumentParser(prog="python -m data.depth.photometric", description=main.__doc__)
    parser.add_argument("--output", type=Path, default=SHIPPED, help="ONNX file to write (default: the shipped one)")
    parser.add_argument("--field-of-view-deg", type=float, default=60.0, help="horizontal field of view (default: 60)")
    arguments = parser.parse_args()
    try:
        write_photometric(arguments.output, arguments.field_of_view_deg)
    except (ValueError, OSError) as error:
        parser.error(str(error))
    print(f"{arguments.output}: use it with depth.source={arguments.output} and depth.preset=photometric")


if __name__ == "__main__":
    run_door(main)
