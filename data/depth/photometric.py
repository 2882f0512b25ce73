"""A depth model that needs no training: brightness under a light at the camera, as a small ONNX graph.

In an endoscope the light is next to the lens, so a matt surface of albedo ρ at the distance R along its ray sends back
I ∝ ρ·cosθ/R², θ being the angle between its normal and the ray. With R = z/cosα, where α is the ray's angle to the
optical axis, and a surface parallel to the image plane (θ = α), z = cos^1.5(α)·sqrt(ρ/I): relative depth for one albedo
and one exposure.

`write_photometric` writes it; the file that is shipped in this folder gives bit-identical depth.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx.inliner import inline_local_functions
from onnxscript import FLOAT, opset18, script

from palpate.common.output import replacing_own

op: Any = opset18
CHANNELS = onnx.numpy_helper.from_array(np.array([[[[0.7]], [[0.3]], [[0]]]], np.float32))
"""Weights of the linear channels. Blood absorbs green and blue, so red varies least with albedo; green helps where red
saturates."""
WINDOW = 9
"""Window of the morphological filters [px of the network's input, 428 wide]: highlights and vessels are narrower."""
TOLERANCE = 1.2
"""Largest ratio of brightness to the filtered brightness; larger differences are limited to it."""
RADIUS = 18
"""Half width of the smoothing kernel, three standard deviations [px of the network's input]."""
WEIGHTS = np.exp(-0.5 * (np.arange(-RADIUS, RADIUS + 1) / (RADIUS / 3)) ** 2)
WEIGHTS /= WEIGHTS.sum()
DOWN = onnx.numpy_helper.from_array(WEIGHTS.astype(np.float32).reshape(1, 1, -1, 1))
ACROSS = onnx.numpy_helper.from_array(WEIGHTS.astype(np.float32).reshape(1, 1, 1, -1))
DARKEST = 0.005
"""Least linear brightness (white = 1) of a valid pixel, 15 of 255 in sRGB; sensor noise dominates in darker ones."""


@script()
def _luminance(image):
    """Linear brightness [1, 1, H, W]: sRGB undone (IEC 61966-2-1), red and green weighted."""
    high = ((image + 0.055) / 1.055) ** 2.4
    linear = op.Where(image <= 0.04045, image / 12.92, high)
    return op.Conv(linear, op.Constant(value=CHANNELS))


@script()
def _largest(values):
    return op.MaxPool(values, kernel_shape=[WINDOW, WINDOW], pads=[WINDOW // 2, WINDOW // 2, WINDOW // 2, WINDOW // 2])


@script()
def _despeckle(brightness):
    """Brightness with narrow highlights (opening) and narrow dark lines (closing) pulled in."""
    opened = _largest(-_largest(-brightness))
    filtered = -_largest(-_largest(opened))
    return op.Max(op.Min(brightness, filtered * TOLERANCE), filtered / TOLERANCE)


@script()
def _blurred(values):
    vertical = op.Conv(values, op.Constant(value=DOWN), pads=[RADIUS, 0, RADIUS, 0])
    return op.Conv(vertical, op.Constant(value=ACROSS), pads=[0, RADIUS, 0, RADIUS])


@script()
def _smooth(brightness):
    """Gaussian mean over usable pixels only (normalised convolution, also at the picture's border); 0 elsewhere."""
    usable = op.Cast(brightness > DARKEST, to=onnx.TensorProto.FLOAT)
    return _blurred(brightness * usable) / op.Max(_blurred(usable), 1e-6) * usable


@script()
def _centred(size):
    """Index of every pixel along a side, from the picture's centre."""
    indices = op.Cast(op.Range(0, op.Squeeze(size), 1), to=onnx.TensorProto.FLOAT)
    return indices - (op.Cast(size, to=onnx.TensorProto.FLOAT) - 1.0) / 2.0


def build_photometric(field_of_view_deg: float = 60.0) -> onnx.ModelProto:
    """The model: input `image` [1, 3, H, W] sRGB in [0, 1], output `depth` [1, H, W], relative, 0 = too dark.

    Every pixel of every frame is treated in the same way; nothing is normalised by the frame, so a change of exposure
    appears as a change of depth.

    Args:
        field_of_view_deg: horizontal field of view of the camera [degrees].

    Raises:
        ValueError: the field of view is not between 0 and 180 degrees.
    """
    if not 0 < field_of_view_deg < 180:
        raise ValueError(f"The field of view is {field_of_view_deg}; give degrees between 0 and 180.")
    # Width of the picture at unit depth; pixels are square.
    span = 2 * math.tan(math.radians(field_of_view_deg) / 2)

    @script()
    def photometric_depth(image):
        brightness = _smooth(_despeckle(_luminance(image)))
        height, width = op.Shape(image, start=2, end=3), op.Shape(image, start=3, end=4)
        pitch = span / op.Cast(width, to=onnx.TensorProto.FLOAT)
        across = op.Reshape(_centred(width) * pitch, op.Constant(value_ints=[1, 1, 1, -1]))
        down = op.Reshape(_centred(height) * pitch, op.Constant(value_ints=[1, 1, -1, 1]))
        cosine = op.Reciprocal(op.Sqrt(down * down + across * across + 1.0))
        distance = op.Reciprocal(op.Sqrt(op.Max(brightness, DARKEST)))
        kept = op.Where(brightness > DARKEST, cosine**1.5 * distance, 0.0)
        depth = op.Squeeze(kept, op.Constant(value_ints=[1]))
        return depth  # noqa: RET504  the name is the output's

    types = {"input_types": [FLOAT[1, 3, "height", "width"]], "output_types": [FLOAT[1, "height", "width"]]}
    model = inline_local_functions(photometric_depth.to_model_proto(**types, ir_version=9, producer_name="palpate"))
    onnx.checker.check_model(model, full_check=True)
    return model


def write_photometric(path: Path, field_of_view_deg: float = 60.0) -> None:
    """Write the model to a file; a user's stays.

    Raises:
        ForeignFile: the path holds a file that this program did not write.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing_own(path) as partial:
        onnx.save(build_photometric(field_of_view_deg), str(partial))
