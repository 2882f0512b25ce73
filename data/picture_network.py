"""ONNX networks that take a colour picture, for depth and for masks: opened, checked, fed and run."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from palpate.common.onnx_devices import DeviceError, first_line, open_session, opening_problem, provider_of
from palpate.data.source.camera import MOST_SIDE
from palpate.data.source.layout import InputError


class PictureNetwork:
    """A network in a file that takes one picture.

    Args:
        path: ONNX file.
        threads: intra-op threads, 0 = onnxruntime's choice.
        device: one of `palpate.common.onnx_devices.DEVICES`.
        raw: True = the network may take 8-bit numbers, which hold no normalised picture.

    Raises:
        InputError: no such file or device, not an ONNX model, or other inputs than one picture.
    """

    def __init__(self, path: Path, *, threads: int = 0, device: str = "cpu", raw: bool = False) -> None:
        self.path = path
        try:
            session = open_session(str(path), threads, device)
        except DeviceError as error:
            raise InputError(str(error)) from error
        except Exception as error:  # onnxruntime's errors share no base class of their own
            raise InputError(f"{path} {opening_problem(error)}.") from error
        self._session, inputs = session, session.get_inputs()
        types = {"tensor(float)": np.float32, "tensor(float16)": np.float16, "tensor(double)": np.float64}
        if raw:
            types["tensor(uint8)"] = np.uint8
        if len(inputs) != 1 or len(inputs[0].shape) != 4 or inputs[0].type not in types:
            found = ", ".join(f"{entry.name} {entry.type} {entry.shape}" for entry in inputs)
            raise InputError(f"{path} takes {found}, and not one colour picture; export it that way.")
        self._input, self._dtype = inputs[0], types[inputs[0].type]
        self.outputs = [entry.name for entry in session.get_outputs()]
        """Names of the network's outputs."""

    @property
    def outlines_instruments(self) -> bool:
        """True if the file states that `configs/masks.yaml` trained it."""
        return '"kind": "instruments"' in self._session.get_modelmeta().custom_metadata_map.get("palpate", "")

    @property
    def provider(self) -> str:
        """Provider of ONNX Runtime that runs the network."""
        return provider_of(self._session)

    def fixed_size(self, axes: str) -> tuple[int | None, int | None]:
        """Height and width that the file prescribes [px], None where they are free.

        Args:
            axes: order of the input's axes, NCHW or NHWC.

        Raises:
            InputError: the file does not take one picture of three channels in that order, or none of usable size.
        """
        # A dimension that is a name or None is free.
        fixed = [side if isinstance(side, int) else None for side in self._input.shape]
        sides = dict(zip(axes, fixed, strict=True))
        if sides["C"] in (3, None) and sides["N"] not in (1, None):
            problem = f"takes {sides['N']} pictures at once; export it with a batch of 1 or a dynamic batch axis"
            raise InputError(f"{self.path} {problem}.")
        if sides["N"] not in (1, None) or sides["C"] not in (3, None):
            problem = f"{self.path} takes an input '{self._input.name}' of shape {self._input.shape}, and not one"
            raise InputError(f"{problem} colour picture as {axes}; correct the order of the axes in its settings.")
        if any(side is not None and not 1 <= side <= MOST_SIDE for side in (sides["H"], sides["W"])):
            problem = f"{self.path} takes pictures of {sides['H']}x{sides['W']};"
            raise InputError(f"{problem} export it for 1 to {MOST_SIDE}.")
        return sides["H"], sides["W"]

    def run(self, tensor: np.ndarray, outputs: Sequence[str] | None = None) -> list[np.ndarray]:
        """The named outputs, or all, for an input of `network_input`.

        Raises:
            InputError: the network fails on it.
        """
        given = (np.rint(tensor).clip(0, 255) if self._dtype is np.uint8 else tensor).astype(self._dtype)
        try:
            return [np.asarray(value) for value in self._session.run(outputs, {self._input.name: given})]
        except Exception as error:  # onnxruntime's errors share no base class of their own
            problem = f"{self.path} fails on an input of shape {list(tensor.shape)} ({first_line(error)});"
            raise InputError(f"{problem} check the size that its settings say.") from error


def resized(picture: np.ndarray, height: int, width: int) -> np.ndarray:
    """A picture at another size: area average when shrinking, bilinear when enlarging."""
    shrinking = height * width < picture.shape[0] * picture.shape[1]
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA if shrinking else cv2.INTER_LINEAR)


def network_input(
    picture: np.ndarray, factor: float, mean: Sequence[float], std: Sequence[float], axes: str
) -> np.ndarray:
    """A picture as a network's input: (picture · factor − mean)/std, float32, [1, 3, h, w] or [1, h, w, 3].

    Args:
        picture: values from 0 to 255, shape [h, w, 3].
        factor: factor on the values.
        mean, std: mean and standard deviation of the channels, in the picture's own order.
        axes: NCHW or NHWC.
    """
    values = (picture * np.float32(factor) - np.asarray(mean, np.float32)) / np.asarray(std, np.float32)
    return np.ascontiguousarray((values if axes == "NHWC" else values.transpose(2, 0, 1))[None])
