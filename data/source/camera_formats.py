"""Camera files of OpenCV, ROS and SCARED, recognised by their content and turned into this project's keys."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from palpate.common.settings import shown
from palpate.data.source.layout import InputError

LARGEST_BASELINE = 0.5
"""Largest distance of a pair's cameras [m]; larger numbers are in millimetres."""


def own_entries(entries: Mapping[str, Any], where: str) -> Mapping[str, Any]:
    """Entries of a camera file by this project's keys; those of no known program stay as they are.

    Without a size, the camera is one of pictures as they come: its width and height are 0.

    Args:
        entries: content of the file.
        where: beginning of the error message.

    Raises:
        InputError: the file is not as its program writes it, or the lens has another model than OpenCV's.
    """
    held = entries.get("camera-calibration", entries)  # SCARED's JSON
    known = {str(name).lower(): value for name, value in held.items()} if isinstance(held, dict) else {}
    for keys, program, read in (
        (("camera_matrix",), "OpenCV or ROS", _single),
        (("k", "d"), "ROS", _single),
        (("m1", "d1"), "OpenCV", _pair),
        (("kl", "dl"), "SCARED", _pair),
    ):
        if all(name in known for name in keys):
            try:
                return read(known)
            except InputError as error:
                raise InputError(f"{where} {error}") from error
            except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
                problem = f"{where} is not as {program} writes a camera ({type(error).__name__}: {error})"
                raise InputError(f"{problem}; calibrate again, or give fx, fy, cx, cy, width, height.") from error
    return entries


def _camera(matrix: Any, bent: Any, width: Any = 0, height: Any = 0, lens: Any = "") -> dict[str, Any]:
    """Entries of one camera from its matrix K, its distortion, its picture's size and the name of its lens model."""
    if lens not in ("", "none", "plumb_bob", "radtan", "rational_polynomial"):  # names of OpenCV's
        raise InputError(f"has the lens model {shown(lens)}; undistort the pictures, or calibrate with plumb_bob.")
    fx, skew, cx, _, fy, cy, *_ = _numbers(matrix, 9)
    if abs(skew) > 1e-3 * abs(fx):
        raise InputError(f"has a skew of {skew:g}, which is not supported; calibrate without.")
    size = {"width": int(width), "height": int(height)}
    return {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "distortion": _numbers(bent)} | size


def _numbers(value: Any, count: int | None = None) -> list[float]:
    """Numbers of a matrix, given as rows, as one list, or by OpenCV with its `data`."""
    found = np.asarray(value["data"] if isinstance(value, dict) else value, float).ravel().tolist()
    if count not in (None, len(found)):
        raise ValueError(f"{len(found)} numbers where {count} are needed")
    return found


def _single(known: Mapping[str, Any]) -> dict[str, Any]:
    """OpenCV's and ROS's file of one camera, or a message of ROS."""
    matrix, bent = known.get("camera_matrix", known.get("k")), known.get("distortion_coefficients", known.get("d"))
    width, height = (known.get(f"image_{side}", known.get(side, 0)) for side in ("width", "height"))
    lens = "fisheye" if known.get("fisheye_model") else known.get("distortion_model", "")
    return _camera(matrix, [] if bent is None else bent, width, height, lens)


def _pair(known: Mapping[str, Any]) -> dict[str, Any]:
    """OpenCV's stereo calibration, and SCARED's: two cameras, rotation and translation; no size."""
    left, right = (("kl", "dl"), ("kr", "dr")) if "kl" in known else (("m1", "d1"), ("m2", "d2"))
    found = _camera(*(known[name] for name in left))
    if right[0] in known:
        found["right"] = _camera(*(known[name] for name in right))
    if "t" not in known:
        return found
    moved = np.array(_numbers(known["t"], 3))
    metres = moved / 1000 if np.abs(moved).max() > LARGEST_BASELINE else moved
    return found | {"rotation": _numbers(known["r"], 9), "translation": metres.tolist()}
