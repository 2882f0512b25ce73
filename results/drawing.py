"""Text and translucent panels on video frames, drawn with OpenCV."""

from __future__ import annotations

import textwrap
from typing import Literal

import cv2
import numpy as np

from results.verdicts import Color

WHITE: Color = (255, 255, 255)

# OpenCV 5 draws Unicode with an embedded TrueType font; OpenCV 4 knows only the ASCII stroke fonts.
_FONT = cv2.FontFace("sans") if hasattr(cv2, "FontFace") else None
_ASCII = str.maketrans({"±": "~", "·": "-", "–": "-", "—": "-", "×": "x", "≈": "~", "√": "sqrt ", "°": " deg"})
_STROKE_HEIGHT = 30.0
"""Size [px] at which OpenCV's Hershey simplex font is as tall as the TrueType one, at font scale 1."""


def text(
    image: np.ndarray,
    string: str,
    origin: tuple[float, float],
    size: float,
    color: Color,
    *,
    bold: bool = False,
    align: Literal["left", "right"] = "left",
) -> None:
    """Write one line on an RGB image in place.

    Args:
        image: uint8, shape [H, W, 3].
        origin: (x, y) of the baseline's left or right end, by `align` [px].
        size: height of the font [px].
    """
    string = _drawable(string)
    shift = text_width(string, size, bold=bold) if align == "right" else 0
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


def wrap_text(string: str, width: float, size: float) -> list[str]:
    """A text in lines of at most `width` px, broken between words, and within longer ones such as paths."""
    count = max(1, int(50 * width / text_width("n" * 50, size)))
    lines = textwrap.wrap(string, count)
    while count > 1 and max((text_width(line, size) for line in lines), default=0) > width:
        count -= 1
        lines = textwrap.wrap(string, count)
    return lines


def shade(
    image: np.ndarray, corner: tuple[int, int], size: tuple[int, int], opacity: float, color: Color = (10, 14, 22)
) -> None:
    """Blend a rectangle from `corner` (x, y), of `size` (width, height) and one colour, over an RGB image, in place."""
    (left, top), (width, height) = corner, size
    region = image[max(top, 0) : top + height, max(left, 0) : left + width]
    if region.size:
        cv2.addWeighted(region, 1 - opacity, np.full_like(region, color), opacity, 0, dst=region)


def _drawable(string: str) -> str:
    """Text without the stand-ins for bytes of file names that are not UTF-8, which OpenCV refuses."""
    return string.encode("utf-8", "replace").decode()


def _to_ascii(string: str) -> str:
    return string.translate(_ASCII).encode("ascii", "replace").decode("ascii")
