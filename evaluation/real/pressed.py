"""A dent of known force: the scale is fitted on the frames whose force is known, the others are predicted.

On a linear sheet pressed on one patch every displacement is the force times a shape, so the deepest dent A tells the
force: F = c·A. A ramp shows no more. Damping would add c·τ·dA/dt; the clocks of camera and sensor may differ by a
frame, which looks the same, so that τ counts as determined only where it is well beyond that.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from palpate.data.source.images import read_image
from palpate.data.source.layout import InputError, list_folder
from palpate.data.source.table import read_columns
from palpate.estimators.estimate import NINETY
from palpate.estimators.known_force import predict_force
from palpate.physics.identifiability import LIMIT

UNIT = 0.05
"""Of the stored depth [mm]."""
REST = slice(20, 56)
"""Frames that show the surface at rest, and the sensor's zero."""
KNOWN = (57, 73)
"""Frames whose force is known: the ramp."""
DEVELOPED = (57, 67)
"""The part of them that is fitted where the force of later frames is not at hand."""
LAST = 113
"""Frame behind the last one that is judged."""
MEDIAN, BLUR = 5, 4.0
"""Widths of the filters against a depth sensor's noise [px]."""
FARTHEST = 12.0
"""A larger change is the sensor's error [mm]."""
CLOCK = 1.0
"""Standard deviation of the difference between the clocks [frames]."""
FORCES = ("Fx_N", "Fy_N", "Fz_N")


@dataclass(frozen=True, eq=False)
class Press:
    """What is measured of a press; T frames."""

    measures: dict[str, object]
    """Numbers and words by name."""
    dent: np.ndarray
    """Deepest dent, shape [T] [mm]."""
    force: np.ndarray
    """Measured, shape [K], K ≤ T [N]."""
    predicted: np.ndarray
    """Shape [T] [N]."""
    sd: np.ndarray
    """Its standard deviation, shape [T] [N]."""
    fitted: tuple[int, int]
    """First frame that is fitted, and the one behind the last."""


def evaluate_press(folder: Path, wrench: Path) -> Press:
    """Fit the scale on the known frames and predict the others.

    Where the wrench does not go beyond the known frames, the first ten of them are fitted and the others judged.

    Args:
        folder: with `depth/`, one picture a frame.
        wrench: table of the force, one row a frame.

    Raises:
        InputError: either can't be read, or holds too few frames.
    """
    dent, force = deepest_dent(folder), measured_force(wrench)
    if len(dent) < KNOWN[1] or len(force) < KNOWN[1]:
        raise InputError(f"{folder} has {len(dent)} frames and {wrench} {len(force)} rows; {KNOWN[1]} are needed.")
    fitted = KNOWN if min(len(force), len(dent)) > KNOWN[1] else DEVELOPED
    if not dent[slice(*fitted)].any():
        raise InputError(f"{folder} shows no dent in frames {fitted[0]} to {fitted[1] - 1}, whose force is known.")
    known = np.full(len(dent), np.nan)
    known[slice(*fitted)] = force[slice(*fitted)]
    curve = predict_force(known, dent, np.zeros(len(dent)))
    predicted, sd, factor = curve.force, curve.sd, curve.factor
    judged = slice(fitted[1], min(len(force), len(dent), LAST))
    error = force[judged] - predicted[judged]
    time, time_sd = damping_time(dent, force, fitted)
    determined = bool(time > 0 and time_sd / time < LIMIT)
    measures: dict[str, object] = {
        "status": "ok",
        "frames fitted": f"{fitted[0]} to {fitted[1] - 1}",
        "frames judged": f"{judged.start} to {judged.stop - 1}",
        "force over dent [N/mm]": factor,
        "force over dent, low [N/mm]": factor - NINETY * curve.factor_sd,
        "force over dent, high [N/mm]": factor + NINETY * curve.factor_sd,
        "RMS error of the force [N]": float(np.sqrt(np.square(error).mean())),
        "RMS of the force [N]": float(np.sqrt(np.square(force[judged]).mean())),
        "frames within the 90 % intervals": float((np.abs(error) < NINETY * sd[judged]).mean()),
        "damping time": "determined" if determined else "not determined",
    }
    return Press(measures, dent, force, predicted, sd, fitted)


def damping_time(dent: np.ndarray, force: np.ndarray, fitted: tuple[int, int]) -> tuple[float, float]:
    """τ of F = c·(A + τ·dA/dt) and its standard deviation, the clocks' difference included [frames]."""
    frames = slice(*fitted)
    columns = np.column_stack([dent, np.gradient(dent)])[frames]
    (factor, slope), *_ = np.linalg.lstsq(columns, force[frames], rcond=None)
    left = np.square(force[frames] - columns @ [factor, slope]).sum() / max(len(columns) - 2, 1)
    covariance = left * np.linalg.pinv(columns.T @ columns)
    time = slope / factor
    row = np.array([-time, 1]) / factor
    return float(time), float(np.sqrt(row @ covariance @ row + CLOCK**2))


def deepest_dent(folder: Path) -> np.ndarray:
    """How far the surface has come towards the camera at its farthest, in every frame, shape [T] [mm].

    Raises:
        InputError: there are no depth pictures, or they can't be read.
    """
    depth = folder / "depth"
    files = [path for path in list_folder(depth) if path.suffix.lower() == ".png"] if depth.is_dir() else []
    if len(files) < REST.stop:
        raise InputError(
            f"{depth} holds {len(files)} depth pictures; give the folder of a press with {REST.stop} or more."
        )
    shape = _depth(files[0]).shape
    # One at a time but for the rest: a press may be long.
    rest = np.median([_depth(path, shape) for path in files[REST]], axis=0)
    return np.array([_deepest(_depth(path, shape), rest) for path in files])


def _depth(path: Path, shape: tuple[int, ...] | None = None) -> np.ndarray:
    """A stored depth map [H, W] [mm], 0 where there is none."""
    stored = read_image(path, cv2.IMREAD_UNCHANGED)
    if stored.ndim != 2 or stored.dtype != np.uint16:
        raise InputError(f"{path} is no depth picture; give one channel of 16 bits, {UNIT:g} mm a unit.")
    if shape is not None and stored.shape != shape:
        raise InputError(f"{path} has the size {stored.shape} and the first one {shape}; give those of one press.")
    return stored * np.float32(UNIT)


def _deepest(depth: np.ndarray, rest: np.ndarray) -> float:
    dent = cv2.medianBlur(np.where((depth > 0) & (rest > 0), rest - depth, 0).astype(np.float32), MEDIAN)
    dent[np.abs(dent) > FARTHEST] = 0
    return float(cv2.GaussianBlur(dent, (0, 0), BLUR).max())


def measured_force(wrench: Path) -> np.ndarray:
    """Length of the force above its mean at rest, shape [K] [N].

    Raises:
        InputError: the table can't be read, or lacks a column or the frames at rest.
    """
    force = read_columns(wrench, FORCES, "table of forces")
    if len(force) < REST.stop:
        raise InputError(f"{wrench} has {len(force)} rows; {REST.stop} or more are needed, one a frame.")
    if not np.isfinite(force).all():
        raise InputError(f"{wrench} holds a force that is no number; leave such rows out of the file's end.")
    return np.linalg.norm(force - force[REST].mean(axis=0), axis=1)
