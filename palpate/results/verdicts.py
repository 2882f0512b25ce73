"""Format results for pictures and pages: verdict first, numbers rounded to their uncertainty, each with its unit."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from palpate.estimators.estimate import REPORTED, SYMBOLS
from palpate.estimators.records import FrameEstimate, InteractionEstimate
from palpate.estimators.result import ENDS
from palpate.physics.mechanics import PARAMETERS

Color = tuple[int, int, int]


@dataclass(frozen=True)
class Note:
    """Meaning of a verdict or a status, and what to do about it."""

    color: Color
    """Colour, the same in all pictures (RGB); only `determined` is green."""
    words: str
    """The verdict or status as pictures and pages show it."""
    text: str = ""
    remedy: str = ""


# fmt: off
NOTES = {
    "determined": Note((22, 163, 74), "stiffness, damping and force known",
        "Stiffness, damping and force are determined; ± is the 90 % interval.",
        "Use all three, each with its 90 % interval."),
    "ratios": Note((37, 99, 235), "only ratios known",
        "Only k_d/k_s and |F|/k_s are determined; ± is the 90 % interval.",
        "Use k_d/k_s (a time) and F/k_s (a length), not k_s, k_d or F themselves. One known stiffness "
        "gives all three (--force-scale)."),
    "relative_force": Note((76, 90, 140), "only the change of force known",
        "Only how the force at the grip changes over time is determined.",
        "Use that and no more. A force that was measured for a while gives newtons (--force-scale)."),
    "stiffness_ratios": Note((79, 70, 229), "only stiffer places known",
        "Only where tissue is stiffer or softer is determined, where it is coloured.",
        "Use the map of where tissue is stiffer."),
    "onset_in_view": Note((129, 140, 248), "rough estimate without interval",
        "The onset was observed; the model does not say what is determined.",
        "Take the numbers as a hint; --estimator network or direct says how sure they are."),
    "undetermined": Note((217, 119, 6), "too uncertain to use", "Not determined by what was observed so far.",
        "Use only what is named as determined, if anything. The onset of contact is not in view, depth is too "
        "noisy, or the model does not explain the motion: try --estimator direct, or give depth of your own."),
    "doubtful": Note((217, 119, 6), "doubtful"),
    "no_estimate": Note((107, 114, 128), "no estimate", "",
        "Use nothing of it. Often the clip begins in contact, or the instrument's mask is wrong: look at the "
        "overlay."),
    "ok": Note((107, 114, 128), "in contact", "An instrument touches tissue."),
    "no_contact": Note((147, 197, 253), "no contact", "An instrument is in view and does not touch tissue.",
        "If it does touch, look at the overlay: does the mask's outline reach the tissue?"),
    "no_tool": Note((203, 213, 225), "no instrument in view", "No instrument is found.",
        "If one is in view, outline it in one frame or give masks (--masks)."),
    "no_tissue": Note((148, 163, 184), "no tissue in view", "No tissue is found.",
        "Look at the overlay; if tissue is in view, give masks of your own (--masks)."),
    "bad_depth": Note((220, 38, 38), "depth unusable", "Depth is missing or unusable.",
        "Check the depth files, or let depth be estimated (--depth photometric)."),
    "unreadable": Note((17, 24, 39), "picture unreadable", "The picture can't be read.",
        "Copy or export the video again; what is said of the other frames stands."),
    "no_mask": Note((147, 51, 234), "mask missing", "There is no mask of this frame.",
        "Complete the masks, or give --masks automatic."),
    "repeated": Note((100, 116, 139), "picture repeated",
        "The picture, or its depth, is that of the frame before: nothing was measured.",
        "Record at the rate at which the camera gives pictures; what is said of the other frames stands."),
}
# fmt: on
"""Notes on every verdict, on a fit that can't be trusted or is missing, and on every status without verdict."""
OWN_UNITS = "u and f: the clip's own units of length and force (scene units), not m and N"
ALARMS: dict[str, tuple[str, Color | None]] = {
    "below": ("Force limit: below.", None),
    "above": ("Force limit: ABOVE.", (220, 38, 38)),
    "unknown": ("Force limit: unknown, neither safe nor unsafe.", (250, 204, 21)),
}
"""Text of the alarm, and the colour of the picture's edge."""


def state(result: FrameEstimate | InteractionEstimate) -> str:
    """Return the verdict of a frame or a contact, or why it has none."""
    return result.verdict or (result.status if isinstance(result, FrameEstimate) else "no_estimate")


def in_words(name: str) -> str:
    """Return a verdict or status as pictures and pages show it."""
    return NOTES[name].words if name in NOTES else name.replace("_", " ")


def digits(value: float) -> str:
    """Return a number to two significant digits, without an exponent below a million."""
    return f"{float(f'{value:.2g}'):g}"


def rounded(value: float, half: float) -> str:
    """Return a number with half its 90 % interval, both to the second digit of the latter."""
    places = 1 - math.floor(math.log10(half)) if half > 0 else 3
    return f"{value:.{max(places, 0)}f} ± {half:.{max(places, 0)}f}"


def numbers(verdict: str, values: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Return the symbol, text and unit of every parameter, as sure as the verdict lets it be.

    With half its 90 % interval after ± where it is determined, else the interval, and a dash where there is none.
    Ratios are given where only they, or one of them, are determined; a model that doesn't say what is gets two digits.

    Args:
        values: of a frame or a contact, by column, names in `determined` one by one, as results.json has them; those in
            newtons have the columns of their units.
    """
    found, single = [], (values.get("determined") or ()) if verdict == "undetermined" else ()
    for name, own_unit in zip(REPORTED, ("f/u", "f·s/u", "f", "s", "u"), strict=True):
        ratio = name not in PARAMETERS
        value, low, high = (values.get(f"{name}{end}") for end in ENDS)
        if value is None or (ratio and verdict != "ratios" and name not in single):
            continue
        text = f"≈ {digits(value)}" if verdict == "onset_in_view" else "—"
        if low is not None and high is not None:
            sure = ratio or verdict == "determined" or name in single
            text = rounded(value, (high - low) / 2) if sure else f"{digits(low)} to {digits(high)}"
        found.append((SYMBOLS[name], text, (values.get(f"{name}_unit") or own_unit).partition(",")[0]))
    return found
