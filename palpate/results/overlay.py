"""Overlay on the clip: stiffness, outlines, contact point, force arrow, verdict and numbers."""

import textwrap

import cv2
import numpy as np

from palpate.data.labels import TISSUE, TOOL
from palpate.estimators.online.particle_field import ParticleField
from palpate.estimators.records import FrameEstimate
from palpate.estimators.result import values_of
from palpate.results.verdicts import ALARMS, NOTES, Color, in_words, numbers, state

Place = tuple[float, float]
WHITE: Color = (255, 255, 255)
_SOFT: Color = (203, 213, 225)
CORNERS = [(0, 0), (0, 1), (1, 0), (1, 1)]
_FONT = cv2.FontFace("sans")
OPACITY = 0.55
RANGE = 4.0
"""Colours end at this many times the median, and at one over it."""
STIFF, MIDDLE, SOFT = (np.array(color, float) for color in ((214, 40, 40), (245, 240, 235), (37, 99, 235)))


def canvas_size(size: tuple[int, int]) -> tuple[int, int]:
    """Return the width and height of the overlay for source frames of `size`: even, as H.264 needs, and wide enough for
    text."""
    factor = max(1, -(-480 // size[0]))
    return (size[0] * factor + 1) // 2 * 2, (size[1] * factor + 1) // 2 * 2


def draw_overlay(
    image: np.ndarray | None,
    size: tuple[int, int],
    labels: np.ndarray | None,
    estimate: FrameEstimate,
    corner: tuple[int, int] = (0, 0),
) -> np.ndarray:
    """Draw one frame of the overlay.

    Args:
        image: source frame, RGB uint8 [H, W, 3]; None where it could not be read (the picture is black then).
        size: width and height of the source frames [px].
        labels: label map of any resolution with the frame's field of view; None where there is none.
        estimate: the frame's result.
        corner: corner of the panel (see `panel_corner`).

    Returns:
        RGB uint8, of `canvas_size(size)`.
    """
    width, height = canvas_size(size)
    canvas = np.zeros((height, width, 3), np.uint8) if image is None else cv2.resize(image, (width, height))
    if image is not None and estimate.field is not None:
        draw_field(canvas, estimate.field, width / size[0], labels)
    if image is not None and labels is not None:
        _outline(canvas, labels, TISSUE, (74, 222, 128))
        _outline(canvas, labels, TOOL, (56, 189, 248))
    _mark_contact(canvas, estimate, width / size[0])
    _panel(canvas, estimate, corner)
    _footer(canvas, estimate)
    edge = ALARMS[estimate.alarm][1] if estimate.alarm else None
    if edge is not None:
        cv2.rectangle(canvas, (0, 0), (width - 1, height - 1), edge, max(3, round(height / 80)))
    return canvas


def draw_field(canvas: np.ndarray, field: ParticleField, factor: float, labels: np.ndarray | None = None) -> None:
    """Paint stiffness against stretch over its median where it is known on an RGB canvas in place.

    Colours are on a logarithmic scale from 1/RANGE to RANGE.

    Args:
        canvas: uint8, shape [H, W, 3].
        factor: pixels of the canvas a pixel of the source frame.
        labels: label map of any resolution: what an instrument hides isn't painted; None = all is.
    """
    known, values = field.distance.known, field.distance.value
    if field.verdict == "undetermined" or not known.any():
        return
    faces, places = field.faces[known[field.faces].all(axis=1)], (field.pixels + 0.5) * factor
    values = values / float(np.median(values[known]))
    found, covered = canvas.copy(), np.zeros(canvas.shape[:2], np.uint8)
    logs = np.log(values[faces].mean(axis=1)) / np.log(RANGE)
    for corners, color in zip(np.round(places[faces]).astype(np.int32), colors(logs), strict=True):
        cv2.fillConvexPoly(found, corners, color.tolist())
        cv2.fillConvexPoly(covered, corners, 1)
    shown = np.ones_like(covered)
    if labels is not None:
        shown = cv2.resize((labels != TOOL).astype(np.uint8), covered.shape[::-1], interpolation=cv2.INTER_NEAREST)
    mixed = cv2.addWeighted(found, OPACITY, canvas, 1 - OPACITY, 0)
    canvas[(covered & shown) > 0] = mixed[(covered & shown) > 0]


def colors(logs: np.ndarray) -> np.ndarray:
    """Return RGB colours of relative stiffness from -1 (soft, blue) to 1 (stiff, red), beyond that as at the ends,
    shape [F, 3]."""
    share = np.clip(logs, -1, 1)[:, None]
    return np.where(share > 0, MIDDLE + share * (STIFF - MIDDLE), MIDDLE - share * (SOFT - MIDDLE))


def _outline(canvas: np.ndarray, labels: np.ndarray, label: int, color: Color) -> None:
    """Draw the smoothed outline of a label's mask; the mask is enlarged to the canvas."""
    height, width = canvas.shape[:2]
    mask = cv2.inRange(labels, label, label)
    reach = 2 * max(1, round(width / mask.shape[1])) + 1
    smooth = cv2.blur(cv2.resize(mask, (width, height)), (reach, reach))
    contours = cv2.findContours(cv2.inRange(smooth, 128, 255), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_TC89_KCOS)[0]
    cv2.drawContours(canvas, contours, -1, color, max(1, round(height / 320)), cv2.LINE_AA)


def _mark_contact(canvas: np.ndarray, estimate: FrameEstimate, factor: float) -> None:
    """Draw a ring at the contact point, and the force arrow that ends there."""
    scale, touch = canvas.shape[0] / 480, estimate.touch
    if touch.arrow is not None:
        tail, tip = (tuple(round((value + 0.5) * factor) for value in point) for point in touch.arrow)
        cv2.arrowedLine(canvas, tail, tip, (20, 20, 20), max(4, round(6 * scale)), cv2.LINE_AA, tipLength=0.3)
        cv2.arrowedLine(canvas, tail, tip, (251, 146, 60), max(2, round(3 * scale)), cv2.LINE_AA, tipLength=0.3)
    if touch.contact_u is not None and touch.contact_v is not None:
        center = (round((touch.contact_u + 0.5) * factor), round((touch.contact_v + 0.5) * factor))
        cv2.circle(canvas, center, max(4, round(7 * scale)), (20, 20, 20), max(3, round(4 * scale)), cv2.LINE_AA)
        cv2.circle(canvas, center, max(4, round(7 * scale)), WHITE, max(1, round(2 * scale)), cv2.LINE_AA)
        if touch.instrument is not None:
            text(canvas, str(touch.instrument), (center[0] + 11 * scale, center[1]), max(11.0, 15 * scale), WHITE)


def panel_corner(labels: np.ndarray | None, before: tuple[int, int] = (0, 0)) -> tuple[int, int]:
    """Return the corner farthest from instruments (0 or 1 down and across), or `before` where that is about as far."""
    labels = None if labels is None else labels[:: 1 + len(labels) // 240, :: 1 + len(labels) // 240]
    places = np.argwhere(labels == TOOL)
    if labels is None or not len(places):
        return before
    away = [np.linalg.norm(places / labels.shape - corner, axis=1).min() for corner in CORNERS]
    best = int(np.argmax(away))
    return CORNERS[best] if away[best] > away[CORNERS.index(before)] + 0.2 else before


def _panel(canvas: np.ndarray, estimate: FrameEstimate, corner: tuple[int, int]) -> None:
    """Draw two lines in a corner: the verdict in words, and numbers or why there are none."""
    height, width = canvas.shape[:2]
    scale = min(height / 480, width / 640)
    size, step, pad = max(11.0, 15 * scale), max(15.0, 21 * scale), max(6, round(10 * scale))
    head, line = in_words(state(estimate)), _second_line(estimate)
    head += f"; {ALARMS[estimate.alarm][0]}" if estimate.alarm else ""
    room = width - 4 * pad
    small = size * min(1.0, max(0.7, room / max(text_width(line, size), 1)))
    first, *rest = [line] if text_width(line, small) <= room else wrap_text(line, room - small, small)
    first += " …" if rest else ""
    box = max(text_width(head, size, bold=True) + size, text_width(first, small)) + 2 * pad, step * (1 + bool(first))
    box = round(box[0]), round(box[1] + 1.3 * pad)
    left = width - pad - box[0] if corner[1] else pad
    top = round(0.83 * height) - box[1] if corner[0] else pad  # a player's controls lie below
    shade(canvas, (left, top), box, 0.66)
    dot = (round(left + pad + size * 0.3), round(top + step - size * 0.35))
    cv2.circle(canvas, dot, round(size * 0.36), NOTES[state(estimate)].color, -1, cv2.LINE_AA)
    text(canvas, head, (left + pad + size, top + step), size, WHITE, bold=True)
    text(canvas, first, (left + pad, top + 2 * step), small, _SOFT)


def _second_line(estimate: FrameEstimate) -> str:
    """Return numbers of the frame with their units, else why there are none."""
    press, field = estimate.estimate, estimate.field
    if field is not None and field.verdict != "undetermined":
        return f"Stiffness against stretch, relative: red {RANGE:g} times the median, blue a {RANGE:g}th."
    shown = []
    if press is not None:
        shown = numbers(estimate.verdict, values_of(press.numbers) | {"determined": press.determined})
    if shown := [each for each in shown if "±" in each[1]] or shown:
        return "   ".join([*map(" ".join, shown), "(f, u: scene units)"])
    return estimate.detail or NOTES[state(estimate)].text


def _footer(canvas: np.ndarray, estimate: FrameEstimate) -> None:
    """Draw frame and time at the lower left, the notice at the lower right."""
    height, width = canvas.shape[:2]
    size = max(10.0, 13 * min(height / 480, width / 640))
    bar = round(size * 1.9)
    shade(canvas, (0, height - bar), (width, bar), 0.55)
    baseline = height - bar * 0.32
    text(canvas, f"frame {estimate.frame}   {estimate.time_s:.2f} s", (size, baseline), size, WHITE)
    text(canvas, "Research software, not a medical device", (width - size, baseline), size, _SOFT, right=True)


def text(
    image: np.ndarray, string: str, at: Place, size: float, color: Color, *, bold: bool = False, right: bool = False
) -> None:
    """Write one line on an RGB image in place.

    Args:
        image: uint8, shape [H, W, 3].
        at: (x, y) of the baseline's left end, or `right` end [px].
        size: height of the font [px].
    """
    shift = text_width(string, size, bold=bold) if right else 0
    position = (round(at[0] - shift), round(at[1]))
    cv2.putText(image, _drawable(string), position, color, _FONT, round(size), 650 if bold else 400)


def text_width(string: str, size: float, *, bold: bool = False) -> int:
    """Return the width of one line [px]."""
    return cv2.getTextSize((1, 1), _drawable(string), (0, 0), _FONT, round(size), 650 if bold else 400)[2]


def wrap_text(string: str, width: float, size: float) -> list[str]:
    """Wrap a text into lines of at most `width` px, broken between words, and within longer ones such as paths."""
    count = max(1, int(50 * width / text_width("n" * 50, size)))
    lines = textwrap.wrap(string, count)
    while count > 1 and max((text_width(line, size) for line in lines), default=0) > width:
        count -= 1
        lines = textwrap.wrap(string, count)
    return lines


def shade(image: np.ndarray, corner: tuple[int, int], size: tuple[int, int], opacity: float) -> None:
    """Darken a rectangle from `corner` (x, y), of `size` (width, height), of an RGB image in place."""
    (left, top), (width, height) = corner, size
    region = image[top : top + height, left : left + width]
    cv2.addWeighted(region, 1 - opacity, np.full_like(region, (10, 14, 22)), opacity, 0, dst=region)


def _drawable(string: str) -> str:
    """Return a text without the stand-ins for bytes of file names that are not UTF-8, which OpenCV refuses."""
    return string.encode("utf-8", "replace").decode()
