"""The clip with what was found drawn on it: outlines, contact point, force arrow, numbers."""

import textwrap

import cv2
import numpy as np

from palpate.data.labels import TISSUE, TOOL
from palpate.estimators.records import FrameEstimate
from palpate.estimators.result import UNITS, values_of
from palpate.results.field_overlay import RANGE, draw_field
from palpate.results.verdicts import ALARMS, NOTES, Color, in_words, numbers, state

Place = tuple[float, float]
WHITE: Color = (255, 255, 255)
_TISSUE_COLOR: Color = (74, 222, 128)
_TOOL_COLOR: Color = (56, 189, 248)
_FORCE_COLOR: Color = (251, 146, 60)
_SOFT: Color = (203, 213, 225)
_FONT = cv2.FontFace("sans")


def canvas_size(size: tuple[int, int]) -> tuple[int, int]:
    """Width and height of the overlay for source frames of `size`: even, as H.264 needs, and wide enough for text."""
    factor = max(1, -(-480 // size[0]))
    return (size[0] * factor + 1) // 2 * 2, (size[1] * factor + 1) // 2 * 2


def draw_overlay(
    image: np.ndarray | None, size: tuple[int, int], labels: np.ndarray | None, estimate: FrameEstimate
) -> np.ndarray:
    """Draw one frame of the overlay.

    Args:
        image: source frame, RGB uint8 [H, W, 3]; None where it could not be read (the picture is black then).
        size: width and height of the source frames [px].
        labels: label map of any resolution with the frame's field of view; None where there is none.
        estimate: the frame's result.

    Returns:
        RGB uint8, of `canvas_size(size)`.
    """
    width, height = canvas_size(size)
    canvas = np.zeros((height, width, 3), np.uint8) if image is None else cv2.resize(image, (width, height))
    if image is not None and estimate.field is not None:
        draw_field(canvas, estimate.field, width / size[0], labels)
    if image is not None and labels is not None:
        _outline(canvas, labels == TISSUE, _TISSUE_COLOR)
        _outline(canvas, labels == TOOL, _TOOL_COLOR)
    _mark_contact(canvas, estimate, width / size[0])
    _panel(canvas, estimate)
    _footer(canvas, estimate)
    edge = ALARMS[estimate.alarm][1] if estimate.alarm else None
    if edge is not None:
        cv2.rectangle(canvas, (0, 0), (width - 1, height - 1), edge, max(3, round(height / 80)))
    return canvas


def _outline(canvas: np.ndarray, mask: np.ndarray, color: Color) -> None:
    """Draw a mask's smoothed outline; the mask is enlarged to the canvas."""
    height, width = canvas.shape[:2]
    reach = 2 * max(1, round(width / mask.shape[1])) + 1
    smooth = cv2.blur(cv2.resize(mask.astype(np.uint8) * 255, (width, height)), (reach, reach))
    contours = cv2.findContours((smooth > 127).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_TC89_KCOS)[0]
    cv2.drawContours(canvas, contours, -1, color, max(1, round(height / 320)), cv2.LINE_AA)


def _mark_contact(canvas: np.ndarray, estimate: FrameEstimate, factor: float) -> None:
    """Ring at the contact point, and the force arrow that ends there."""
    scale, touch = canvas.shape[0] / 480, estimate.touch
    if touch.arrow is not None:
        tail, tip = (tuple(round((value + 0.5) * factor) for value in point) for point in touch.arrow)
        cv2.arrowedLine(canvas, tail, tip, (20, 20, 20), max(4, round(6 * scale)), cv2.LINE_AA, tipLength=0.3)
        cv2.arrowedLine(canvas, tail, tip, _FORCE_COLOR, max(2, round(3 * scale)), cv2.LINE_AA, tipLength=0.3)
    if touch.contact_u is not None and touch.contact_v is not None:
        center = (round((touch.contact_u + 0.5) * factor), round((touch.contact_v + 0.5) * factor))
        cv2.circle(canvas, center, max(4, round(7 * scale)), (20, 20, 20), max(3, round(4 * scale)), cv2.LINE_AA)
        cv2.circle(canvas, center, max(4, round(7 * scale)), WHITE, max(1, round(2 * scale)), cv2.LINE_AA)
        if touch.instrument is not None:
            text(canvas, str(touch.instrument), (center[0] + 11 * scale, center[1]), max(11.0, 15 * scale), WHITE)


def _panel(canvas: np.ndarray, estimate: FrameEstimate) -> None:
    """Verdict, numbers and remarks at the upper left."""
    scale = min(canvas.shape[0] / 480, canvas.shape[1] / 640)
    size, step, pad = max(11.0, 15 * scale), max(15.0, 21 * scale), max(6, round(10 * scale))
    small, width = size * 0.76, min(canvas.shape[1] - 2 * pad, round(max(262 * scale, 190)))
    lines = _number_lines(estimate)
    notes = [line for note in _notes(estimate) for line in wrap_text(note, width - 2 * pad, small)]
    height = round(step * (1.2 + len(lines)) + step * 0.75 * len(notes) + 1.3 * pad)
    shade(canvas, (pad, pad), (width, height), 0.66)
    baseline, right = pad + step, width
    dot = (round(2 * pad + size * 0.3), round(baseline - size * 0.35))
    cv2.circle(canvas, dot, round(size * 0.36), NOTES[state(estimate)].color, -1, cv2.LINE_AA)
    text(canvas, in_words(state(estimate)), (2 * pad + size, baseline), size, WHITE, bold=True)
    for name, value in lines:
        baseline += step
        text(canvas, name, (2 * pad, baseline), size, _SOFT)
        text(canvas, value, (right, baseline), size, WHITE, right=True)
    baseline += step * 0.2
    for note in notes:
        baseline += step * 0.75
        text(canvas, note, (2 * pad, baseline), small, _SOFT)


def _number_lines(estimate: FrameEstimate) -> list[tuple[str, str]]:
    """Name and value of what the frame has."""
    names = {"k_s": "stiffness k_s", "k_d": "damping k_d", "|F|": "force |F|"}
    touch, press = estimate.touch, estimate.estimate
    known = numbers(estimate.verdict, {} if press is None else values_of(press.numbers))
    found = [(names.get(symbol, symbol), value) for symbol, value in known]
    for name, digits, value in (
        ("displacement, simulated", ".2g", touch.simulated_displacement),
        ("displacement, observed", ".2g", touch.observed_displacement),
        ("contact, probability", ".2f", touch.contact_probability),
    ):
        found += [] if value is None else [(name, format(value, digits))]
    return found


def _notes(estimate: FrameEstimate) -> list[str]:
    """Small print under the numbers: what they can't say, why there are none, and their unit."""
    notes = [ALARMS[estimate.alarm][0]] if estimate.alarm else []
    notes += [NOTES[estimate.verdict].text] if estimate.verdict else []
    notes += [estimate.detail] if estimate.detail else []
    if estimate.field is not None and estimate.field.verdict != "undetermined":
        notes.append(f"Stiffness against stretch: red {RANGE:g} times the median, blue a {RANGE:g}th, relative units.")
    if estimate.estimate is None:
        return notes
    unsure = estimate.verdict != "determined" and estimate.estimate.covariance is not None
    return [*notes, f"{'Ranges are 90 % intervals. ' if unsure else ''}Unit: {UNITS['stiffness']}."]


def _footer(canvas: np.ndarray, estimate: FrameEstimate) -> None:
    """Frame and time at the lower left, the notice at the lower right."""
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
    """Width of one line [px]."""
    return cv2.getTextSize((1, 1), _drawable(string), (0, 0), _FONT, round(size), 650 if bold else 400)[2]


def wrap_text(string: str, width: float, size: float) -> list[str]:
    """A text in lines of at most `width` px, broken between words, and within longer ones such as paths."""
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
    """Text without the stand-ins for bytes of file names that are not UTF-8, which OpenCV refuses."""
    return string.encode("utf-8", "replace").decode()
