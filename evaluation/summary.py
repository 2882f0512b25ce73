"""One picture of a clip: stiffness, damping, force and displacement over time, and the status of every frame."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from estimators.estimate import FrameEstimate
from evaluation.drawing import (
    FRAME,
    INK,
    MUTED,
    STATUS_COLORS,
    Axes,
    Color,
    fit_text,
    text,
    text_width,
)

WIDTH, HEIGHT = 1500, 1480
"""Size of the picture [px]."""
_LEFT, _RIGHT, _TOP = 120, 50, 130
_PANEL, _GAP = 220, 62
_BLUE, _GREEN, _ORANGE, _PURPLE, _GREY = (37, 99, 235), (13, 148, 136), (234, 88, 12), (124, 58, 237), (75, 85, 99)

_PANELS: tuple[tuple[str, str, tuple[tuple[str, str, Color], ...]], ...] = (
    ("Stiffness k_s", "stiffness", (("", "stiffness", _BLUE),)),
    ("Damping k_d", "damping", (("", "damping", _GREEN),)),
    ("Force |F|", "force", (("", "force", _ORANGE),)),
    (
        "Contact displacement",
        "displacement",
        (("observed", "observed_displacement", _GREY), ("simulated", "simulated_displacement", _PURPLE)),
    ),
)
"""Title, key of the unit, and the curves (label, attribute of FrameEstimate, colour) of each panel."""


def draw_summary(
    estimates: Sequence[FrameEstimate], *, title: str, subtitle: str = "", units: Mapping[str, str] | None = None
) -> np.ndarray:
    """Draw a clip's summary.

    Args:
        estimates: one a frame, in order.
        title: name of the clip.
        subtitle: what made the numbers.
        units: unit of "stiffness", "damping", "force" and "displacement".

    Returns:
        RGB image, uint8, shape [HEIGHT, WIDTH, 3].
    """
    image = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
    text(image, fit_text(title, WIDTH - _LEFT - _RIGHT, 32, bold=True), (_LEFT, 48), 32, INK, bold=True)
    text(image, fit_text(subtitle, WIDTH - _LEFT - _RIGHT, 18), (_LEFT, 80), 18, MUTED)
    times = np.array([estimate.time_s for estimate in estimates], dtype=float)
    x_range = _time_range(times)
    hollow = np.array([estimate.verdict == "undetermined" for estimate in estimates], dtype=bool)
    top = _TOP
    for index, (name, unit_key, curves) in enumerate(_PANELS):
        unit = (units or {}).get(unit_key, "")
        label = "time [s]" if index == len(_PANELS) - 1 else ""
        _draw_panel(image, top, x_range, times, estimates, hollow, curves, (name, f"[{unit}]" if unit else "", label))
        top += _PANEL + _GAP
    _draw_status_strip(image, top + 46, x_range, times, estimates)
    _draw_footer(image, bool(hollow.any()))
    return image


def write_summary(path: Path, image: np.ndarray) -> None:
    """Store an RGB image as PNG under a temporary name, then rename it.

    Raises:
        OSError: the picture can't be written.
    """
    encoded = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))[1]
    temporary = path.with_name(f".{path.name}.partial")
    temporary.write_bytes(encoded.tobytes())
    os.replace(temporary, path)


def _draw_panel(
    image: np.ndarray,
    top: int,
    x_range: tuple[float, float],
    times: np.ndarray,
    estimates: Sequence[FrameEstimate],
    hollow: np.ndarray,
    curves: tuple[tuple[str, str, Color], ...],
    labels: tuple[str, str, str],
) -> None:
    """One set of axes with its curves, bands of uncertainty where the model gives them, and a legend."""
    values = [_column(estimates, attribute) for _, attribute, _ in curves]
    bands = [_band(estimates, attribute, value) for (_, attribute, _), value in zip(curves, values, strict=True)]
    everything = [edge for value, band in zip(values, bands, strict=True) for edge in (value, *band)]
    width = WIDTH - _LEFT - _RIGHT
    axes = Axes(image, _LEFT, top, width, _PANEL, x_range, _value_range(np.concatenate(everything)))
    axes.frame(*labels[:2], x_label=labels[2])
    if not any(np.isfinite(value).any() for value in values):
        middle = (_LEFT + width / 2, top + _PANEL / 2)
        text(image, "no value in any frame", middle, 18, MUTED, align="center")
        return
    for (_, attribute, color), value, band in zip(curves, values, bands, strict=True):
        axes.band(times, *band, color)
        axes.curve(times, value, color, hollow=None if attribute == "observed_displacement" else hollow)
    right = _LEFT + width
    for label, _, color in reversed([curve for curve in curves if curve[0]]):
        text(image, label, (right, top - 12), 17, INK, align="right")
        right -= text_width(label, 17) + 12
        cv2.line(image, (right - 26, top - 18), (right, top - 18), color, 3, cv2.LINE_AA)
        right -= 48


def _band(estimates: Sequence[FrameEstimate], attribute: str, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """90 % interval where the model gives one, else one standard deviation; limited to five times the value."""
    low, high, sd = (_column(estimates, f"{attribute}_{end}") for end in ("low", "high", "sd"))
    low, high = np.where(np.isfinite(low), low, value - sd), np.where(np.isfinite(high), high, value + sd)
    return low, np.minimum(high, 5 * np.abs(value))


def _draw_status_strip(
    image: np.ndarray, top: int, x_range: tuple[float, float], times: np.ndarray, estimates: Sequence[FrameEstimate]
) -> None:
    """Colour every frame's interval by its status, and say what the colours mean with their counts."""
    width, height = WIDTH - _LEFT - _RIGHT, 34
    text(image, "Status of every frame", (_LEFT, top - 12), 21, INK, bold=True)
    if len(times):
        ends = np.append(times[1:], x_range[1])
        spans = np.round((np.stack([times, ends]) - x_range[0]) / (x_range[1] - x_range[0]) * width).astype(int) + _LEFT
        for left, right, estimate in zip(*spans, estimates, strict=True):
            color = STATUS_COLORS.get(estimate.status, MUTED)
            cv2.rectangle(image, (int(left), top), (int(max(right, left + 1)), top + height), color, -1)
    cv2.rectangle(image, (_LEFT, top), (_LEFT + width, top + height), FRAME, 1)
    counts = Counter(estimate.status for estimate in estimates)
    left = _LEFT
    for status in [name for name in STATUS_COLORS if counts[name]]:
        label = f"{status} {counts[status]}"
        cv2.rectangle(image, (left, top + 56), (left + 18, top + 74), STATUS_COLORS[status], -1)
        text(image, label, (left + 26, top + 72), 18, INK)
        left += 26 + text_width(label, 18) + 34


def _draw_footer(image: np.ndarray, undetermined: bool) -> None:
    if undetermined:
        note = "Rings: stiffness, damping and force are undetermined by what was seen so far. Bands: 90 % intervals."
        text(image, note, (_LEFT, HEIGHT - 46), 16, MUTED)
    text(image, "palpate: research software, not a medical device.", (_LEFT, HEIGHT - 20), 16, MUTED)


def _column(estimates: Sequence[FrameEstimate], attribute: str) -> np.ndarray:
    """One attribute of all frames, shape [n], NaN where there is none."""
    values = (getattr(estimate, attribute, None) for estimate in estimates)
    return np.array([np.nan if value is None else value for value in values], dtype=float)


def _time_range(times: np.ndarray) -> tuple[float, float]:
    """From the first frame to the end of the last one [s]."""
    if len(times) == 0:
        return 0.0, 1.0
    interval = float(np.median(np.diff(times))) if len(times) > 1 else 0.04
    return float(times[0]), float(max(times[-1], times[0]) + max(interval, 1e-3))


def _value_range(values: np.ndarray) -> tuple[float, float]:
    """Range of a vertical axis that starts at 0, where these quantities do, and leaves room above."""
    finite = values[np.isfinite(values)]
    high = float(finite.max()) if len(finite) else 1.0
    low = min(0.0, float(finite.min())) if len(finite) else 0.0
    return low, low + max((high - low) * 1.12, 1e-6)
