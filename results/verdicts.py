"""How pictures show a result: its verdict before its numbers, and no number surer than it is."""

from collections.abc import Mapping
from typing import Any

from palpate.common.files import read_beside
from palpate.estimators.estimate import SYMBOLS
from palpate.estimators.records import FrameEstimate, InteractionEstimate
from palpate.physics.mechanics import PARAMETERS

Color = tuple[int, int, int]

_TEXTS = read_beside(__file__)
COLORS: dict[str, Color] = {name: tuple(color) for name, color in _TEXTS["colors"].items()}
"""One colour (RGB) a verdict, a fit that can't be trusted or is missing, and a status without verdict."""
MEANINGS: dict[str, str] = _TEXTS["meanings"]
"""What the verdicts say, a sentence each."""
ALARMS: dict[str, dict[str, Any]] = _TEXTS["alarms"]
"""What is said of the alarm, and the colour of the picture's edge where it has one."""


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
