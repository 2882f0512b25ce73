"""How pictures show a result: its verdict before its numbers, and no number surer than it is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from palpate.estimators.estimate import SYMBOLS
from palpate.estimators.records import FrameEstimate, InteractionEstimate
from palpate.physics.mechanics import PARAMETERS

Color = tuple[int, int, int]

COLORS: dict[str, Color] = {
    "determined": (22, 163, 74),
    "ratios": (37, 99, 235),
    "reaction": (20, 105, 190),
    "foundation": (8, 120, 165),
    "relative_force": (76, 90, 140),
    "stiffness_ratios": (79, 70, 229),
    "onset_in_view": (129, 140, 248),
    "undetermined": (217, 119, 6),
    "doubtful": (217, 119, 6),
    "no_estimate": (107, 114, 128),
    "ok": (107, 114, 128),
    "no_contact": (147, 197, 253),
    "no_tool": (203, 213, 225),
    "no_tissue": (148, 163, 184),
    "bad_depth": (220, 38, 38),
    "unreadable": (17, 24, 39),
    "no_mask": (147, 51, 234),
}
"""One colour (RGB) a verdict, a fit that can't be trusted or is missing, and a status without verdict, the same in all
pictures; only `determined` is green."""
MEANINGS = {
    "determined": "Stiffness, damping and force are determined.",
    "ratios": "Only k_s/k_d and |F|/k_d are determined.",
    "reaction": "Only the force at the grip over E, and how it changes over time, are determined.",
    "foundation": "Only how firmly tissue is attached, over its stiffness, and relative forces are determined.",
    "relative_force": "Only how the force at the grip changes over time is determined.",
    "stiffness_ratios": "Only where tissue is stiffer or softer is determined, where it is coloured.",
    "onset_in_view": "The onset was observed; the model does not say what is determined.",
    "undetermined": "Not determined by what was observed so far.",
}
"""What the verdicts say, a sentence each."""
FAR = "more than twice or less than half the observed one"


def state(said: FrameEstimate | InteractionEstimate) -> str:
    """What is said first about a frame or a run of contact: its verdict, or why it has none."""
    if isinstance(said, FrameEstimate):
        return said.verdict or said.status
    return said.verdict or "no_estimate"


def in_words(name: str) -> str:
    """A state as pictures show it; `ok` would say more than that the frame is in contact."""
    return "in contact" if name == "ok" else name.replace("_", " ")


def is_far(estimate: FrameEstimate) -> bool:
    """Whether a frame's simulated displacement is more than twice or less than half the observed one."""
    simulated, observed = estimate.simulated_displacement, estimate.observed_displacement
    return simulated is not None and observed is not None and not observed / 2 <= simulated <= 2 * observed


def digits(value: float, count: int) -> str:
    """A number to `count` significant digits, without an exponent below a million."""
    return f"{float(f'{value:.{count}g}'):g}"


def numbers(verdict: str, values: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Symbol and text of every parameter there is, as sure as the verdict lets it be.

    With its standard deviation where it is determined, else its 90 % interval, and a dash where neither is known. The
    ratios are given where only they are determined; a model that doesn't say what is gets two digits.

    Args:
        values: of a frame or a run of contact, by column.
    """
    found = []
    for name in PARAMETERS:
        value, spread, low, high = (values.get(f"{name}{end}") for end in ("", "_sd", "_low", "_high"))
        if value is None:
            continue
        text = f"≈ {digits(value, 2)}" if verdict == "onset_in_view" else "—"
        if verdict == "determined" and spread is not None:
            text = f"{digits(value, 3)} ± {digits(spread, 2)}"
        elif low is not None and high is not None:
            text = f"{digits(low, 2)} to {digits(high, 2)}"
        found.append((SYMBOLS[name], text))
    if verdict == "ratios":
        for name in ("damping_over_stiffness", "force_over_stiffness"):
            found.append((SYMBOLS[name], f"{digits(values[name], 2)} ± {digits(values[f'{name}_sd'], 1)}"))
    return found
