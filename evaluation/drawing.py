"""Text, translucent panels and axes on RGB images, drawn with OpenCV so that inference needs no plotting library."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

Color = tuple[int, int, int]

INK: Color = (31, 41, 55)
MUTED: Color = (107, 114, 128)
GRID: Color = (229, 231, 235)
FRAME: Color = (156, 163, 175)
WHITE: Color = (255, 255, 255)

STATUS_COLORS: dict[str, Color] = {
    "ok": (22, 163, 74),
    "no_contact": (245, 158, 11),
    "no_tool": (203, 213, 225),
    "no_tissue": (148, 163, 184),
    "bad_depth": (220, 38, 38),
    "unreadable": (17, 24, 39),
    "no_mask": (147, 51, 234),
}
"""One colour a frame status, the same in the overlay and in the summary."""

# OpenCV 5 draws Unicode with an embedded TrueType font; OpenCV 4 knows only the ASCII stroke fonts.
_FONT = cv2.FontFace("sans") if hasattr(cv2, "FontFace") else None
_ASCII = str.maketrans({"±": "~", "·": "-", "–": "-", "—": "-", "‖": "|", "×": "x", "θ": "theta", "Δ": "d", "…": "."})
_STROKE_HEIGHT = 30.0
"""Size [px] at which OpenCV's Hershey simplex font is as tall as the TrueType one, at font scale 1."""


def limit_threads(count: int) -> None:
    """Let OpenCV use at most `count` CPU threads, in the whole process; 0 = all."""
    cv2.setNumThreads(count if count else -1)


def text(
    image: np.ndarray,
    string: str,
    origin: tuple[float, float],
    size: float,
    color: Color = INK,
    *,
    bold: bool = False,
    align: Literal["left", "center", "right"] = "left",
) -> None:
    """Write one line on an RGB image in place.

    Args:
        image: uint8, shape [H, W, 3].
        origin: (x, y) of the baseline's left end, middle or right end, by `align` [px].
        size: height of the font [px].
    """
    string = _drawable(string)
    shift = {"left": 0.0, "center": 0.5, "right": 1.0}[align] * text_width(string, size, bold=bold)
    position = (round(origin[0] - shift), round(origin[1]))
    if _FONT is not None:
        cv2.putText(image, string, position, color, _FONT, round(size), 650 if bold else 400)
        return
    stroke, ascii_string = 2 if bold else 1, _to_ascii(string)
    scale = size / _STROKE_HEIGHT
    cv2.putText(image, ascii_string, position, cv2.FONT_HERSHEY_SIMPLEX, scale, color, stroke, cv2.LINE_AA)


def text_width(string: str, size: float, *, bold: bool = False) -> int:
    """Width of one line [px]."""
    string = _drawable(string)
    if not string:
        return 0
    if _FONT is not None:
        _, _, width, _ = cv2.getTextSize((1, 1), string, (0, 0), _FONT, round(size), 650 if bold else 400)
        return int(width)
    stroke = 2 if bold else 1
    (width, _), _ = cv2.getTextSize(_to_ascii(string), cv2.FONT_HERSHEY_SIMPLEX, size / _STROKE_HEIGHT, stroke)
    return int(width)


def fit_text(string: str, width: float, size: float, *, bold: bool = False) -> str:
    """The line itself, or its longest beginning with an ellipsis that is at most `width` px wide."""
    if text_width(string, size, bold=bold) <= width:
        return string
    low, high = 0, len(string)
    while low < high:
        middle = (low + high + 1) // 2
        if text_width(string[:middle].rstrip() + "…", size, bold=bold) <= width:
            low = middle
        else:
            high = middle - 1
    return string[:low].rstrip() + "…"


def shade(
    image: np.ndarray, corner: tuple[int, int], size: tuple[int, int], opacity: float, color: Color = (10, 14, 22)
) -> None:
    """Blend a rectangle from `corner` (x, y), of `size` (width, height) and one colour, over an RGB image, in place."""
    (left, top), (width, height) = corner, size
    region = image[max(top, 0) : top + height, max(left, 0) : left + width]
    if region.size:
        cv2.addWeighted(region, 1 - opacity, np.full_like(region, color), opacity, 0, dst=region)


def nice_ticks(low: float, high: float, count: int = 5) -> np.ndarray:
    """About `count` round numbers from `low` to `high`, spaced by 1, 2 or 5 times a power of ten."""
    span = high - low
    raw = span / max(count, 1)
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= raw * (1 - 1e-9))
    return np.arange(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1) * step


def tick_label(value: float, step: float) -> str:
    """A tick's number with as many digits as the tick spacing needs."""
    if value != 0 and not 1e-4 <= abs(step) < 1e6:
        return f"{value:.3g}"
    digits = max(0, -math.floor(math.log10(step) + 1e-9))
    return f"{value + 0.0:.{digits}f}"


@dataclass(frozen=True)
class Axes:
    """A rectangle of the image that shows a range of numbers.

    `left`, `top`, `width` and `height` are in pixels of `image`; `x_range` and `y_range` in the data's units.
    """

    image: np.ndarray
    left: int
    top: int
    width: int
    height: int
    x_range: tuple[float, float]
    y_range: tuple[float, float]

    def pixels(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Position of data points in the image [px], shape [n, 2]; outliers stay at the border."""
        u = self.left + (np.asarray(x) - self.x_range[0]) / (self.x_range[1] - self.x_range[0]) * self.width
        v = self.top + (self.y_range[1] - np.asarray(y)) / (self.y_range[1] - self.y_range[0]) * self.height
        u, v = np.clip(u, self.left, self.left + self.width), np.clip(v, self.top, self.top + self.height)
        return np.stack([u, v], axis=-1)

    def frame(self, title: str, unit: str, *, x_label: str = "") -> None:
        """Draw grid, ticks, numbers, title with unit, and the label of the horizontal axis where one is given."""
        right, bottom = self.left + self.width, self.top + self.height
        x_ticks, y_ticks = nice_ticks(*self.x_range, 10), nice_ticks(*self.y_range, 5)
        for value in y_ticks:
            v = round(float(self.pixels(self.x_range[0], value)[1]))
            cv2.line(self.image, (self.left, v), (right, v), GRID, 1)
            text(self.image, tick_label(value, _step(y_ticks)), (self.left - 10, v + 6), 17, MUTED, align="right")
        for value in x_ticks:
            u = round(float(self.pixels(value, self.y_range[0])[0]))
            cv2.line(self.image, (u, self.top), (u, bottom), GRID, 1)
            if x_label:
                text(self.image, tick_label(value, _step(x_ticks)), (u, bottom + 24), 17, MUTED, align="center")
        cv2.rectangle(self.image, (self.left, self.top), (right, bottom), FRAME, 1)
        text(self.image, title, (self.left, self.top - 12), 21, INK, bold=True)
        offset = self.left + text_width(title, 21, bold=True) + 14
        text(self.image, fit_text(unit, right - offset, 17), (offset, self.top - 12), 17, MUTED)
        if x_label:
            text(self.image, x_label, (self.left + self.width / 2, bottom + 52), 18, INK, align="center")

    def curve(self, x: np.ndarray, y: np.ndarray, color: Color, *, hollow: np.ndarray | None = None) -> None:
        """Draw points joined where neighbours are finite (a missing value is a gap, never a bridge).

        Args:
            x, y: shape [n]; y is NaN where there is no value.
            hollow: bool, shape [n], points drawn as rings; None draws all filled.
        """
        y = np.asarray(y, dtype=float)
        finite = np.isfinite(y)
        points = np.round(self.pixels(x, np.where(finite, y, self.y_range[0])) * 8).astype(np.int32)
        for run in _runs(finite):
            cv2.polylines(self.image, [points[run]], False, color, 2, cv2.LINE_AA, shift=3)
        if np.count_nonzero(finite) * 4 > self.width:
            return
        for index in np.flatnonzero(finite):
            center = (int(points[index, 0]), int(points[index, 1]))
            cv2.circle(self.image, center, 4 * 8, color, -1, cv2.LINE_AA, shift=3)
            if hollow is not None and hollow[index]:
                cv2.circle(self.image, center, 20, WHITE, -1, cv2.LINE_AA, shift=3)

    def band(self, x: np.ndarray, low: np.ndarray, high: np.ndarray, color: Color) -> None:
        """Shade between two curves where both are finite."""
        finite = np.isfinite(low) & np.isfinite(high)
        layer = self.image.copy()
        for run in _runs(finite):
            edge = np.concatenate([self.pixels(x[run], low[run]), self.pixels(x[run], high[run])[::-1]])
            cv2.fillPoly(layer, [np.round(edge * 8).astype(np.int32)], color, cv2.LINE_AA, shift=3)
        cv2.addWeighted(layer, 0.2, self.image, 0.8, 0, dst=self.image)


def _runs(mask: np.ndarray) -> list[slice]:
    """Stretches of consecutive True values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return [slice(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]


def _step(ticks: np.ndarray) -> float:
    return float(ticks[1] - ticks[0]) if len(ticks) > 1 else 1.0


def _drawable(string: str) -> str:
    """Text without the stand-ins for bytes of file names that are not UTF-8, which OpenCV refuses."""
    return string.encode("utf-8", "replace").decode()


def _to_ascii(string: str) -> str:
    return string.translate(_ASCII).encode("ascii", "replace").decode("ascii")
