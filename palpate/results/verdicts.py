"""How pictures show a result: its verdict before its numbers, and no number surer than it is."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from palpate.estimators.estimate import SYMBOLS
from palpate.estimators.records import FrameEstimate, InteractionEstimate
from palpate.physics.mechanics import PARAMETERS

Color = tuple[int, int, int]


@dataclass(frozen=True)
class Note:
    """What a verdict or a status means, and what to do about it."""

    color: Color
    """The same in all pictures (RGB); only `determined` is green."""
    text: str = ""
    remedy: str = ""


# fmt: off
NOTES = {
    "determined": Note((22, 163, 74), "Stiffness, damping and force are determined; ± is the 90 % interval.",
        "Use all three, each with its 90 % interval."),
    "ratios": Note((37, 99, 235), "Only k_d/k_s and |F|/k_s are determined; ± is the 90 % interval.",
        "Use k_d/k_s (a time) and F/k_s (a length), not k_s, k_d or F themselves. One known force or stiffness "
        "gives all three (--force-scale)."),
    "relative_force": Note((76, 90, 140), "Only how the force at the grip changes over time is determined.",
        "Use that and no more. A force that was measured for a while gives newtons (--force-scale)."),
    "stiffness_ratios": Note((79, 70, 229),
        "Only where tissue is stiffer or softer is determined, where it is coloured.",
        "Use the map of where tissue is stiffer."),
    "onset_in_view": Note((129, 140, 248), "The onset was observed; the model does not say what is determined.",
        "Take the numbers as a hint; --estimator network or direct says how sure they are."),
    "undetermined": Note((217, 119, 6), "Not determined by what was observed so far.",
        "Use only what is named as determined, if anything. The onset of contact is not in view, depth is too "
        "noisy, or the model does not explain the motion: try --estimator direct, or give depth of your own."),
    "doubtful": Note((217, 119, 6)),
    "no_estimate": Note((107, 114, 128), "",
        "Use nothing of it. Often the clip begins in contact, or the instrument's mask is wrong: look at the "
        "overlay."),
    "ok": Note((107, 114, 128), "An instrument touches tissue."),
    "no_contact": Note((147, 197, 253), "An instrument is in view and does not touch tissue.",
        "If it does touch, look at the overlay: does the mask's outline reach the tissue?"),
    "no_tool": Note((203, 213, 225), "No instrument is seen.",
        "If one is in view, outline it in one frame or give masks (--masks)."),
    "no_tissue": Note((148, 163, 184), "No tissue is seen.",
        "Look at the overlay; if tissue is in view, give masks of your own (--masks)."),
    "bad_depth": Note((220, 38, 38), "Depth is missing or unusable.",
        "Check the depth files, or let depth be estimated (--depth photometric)."),
    "unreadable": Note((17, 24, 39), "The picture can't be read.",
        "Copy or export the video again; what is said of the other frames stands."),
    "no_mask": Note((147, 51, 234), "There is no mask of this frame.",
        "Complete the masks, or give --masks automatic."),
    "repeated": Note((100, 116, 139),
        "The picture, or its depth, is that of the frame before: nothing was measured.",
        "Record at the rate at which the camera gives pictures; what is said of the other frames stands."),
}
# fmt: on
"""Of every verdict, of a fit that can't be trusted or is missing, and of every status without verdict."""
ALARMS: dict[str, tuple[str, Color | None]] = {
    "below": ("Force limit: below.", None),
    "above": ("Force limit: ABOVE.", (220, 38, 38)),
    "unknown": ("Force limit: unknown, neither safe nor unsafe.", (250, 204, 21)),
}
"""What is said of the alarm, and the colour of the picture's edge."""


def state(said: FrameEstimate | InteractionEstimate) -> str:
    """What is said first about a frame or a run of contact: its verdict, or why it has none."""
    if isinstance(said, FrameEstimate):
        return said.verdict or said.status
    return said.verdict or "no_estimate"


def in_words(name: str) -> str:
    """A state as pictures show it; `ok` would say more than that the frame is in contact."""
    return "in contact" if name == "ok" else name.replace("_", " ")


def digits(value: float, count: int) -> str:
    """A number to `count` significant digits, without an exponent below a million."""
    return f"{float(f'{value:.{count}g}'):g}"


def numbers(verdict: str, values: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Symbol and text of every parameter there is, as sure as the verdict lets it be.

    With half its 90 % interval after ± where it is determined, else the interval, and a dash where there is none. The
    ratios are given where only they are determined; a model that doesn't say what is gets two digits.

    Args:
        values: of a frame or a run of contact, by column.
    """
    found = []
    for name in PARAMETERS:
        value, low, high = (values.get(f"{name}{end}") for end in ("", "_low", "_high"))
        if value is None:
            continue
        text = f"≈ {digits(value, 2)}" if verdict == "onset_in_view" else "—"
        if low is not None and high is not None:
            text = f"{digits(low, 2)} to {digits(high, 2)}"
            if verdict == "determined":
                text = f"{digits(value, 3)} ± {digits((high - low) / 2, 2)}"
        found.append((SYMBOLS[name], text))
    if verdict == "ratios":
        for name in ("damping_over_stiffness", "force_over_stiffness"):
            half = (values[f"{name}_high"] - values[f"{name}_low"]) / 2
            found.append((SYMBOLS[name], f"{digits(values[name], 2)} ± {digits(half, 1)}"))
    return found
