"""What the programs' command lines share: types of options, and what is told while they work."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from physics.doors import plain

LARGEST_NUMBER = 2**63 - 1
"""Larger numbers are no counts, and no seeds of the libraries that draw."""


def path_option(text: str) -> Path:
    """A path on the command line; an unset shell variable would be the whole working folder.

    Raises:
        ArgumentTypeError: it is empty.
    """
    if not text:
        raise argparse.ArgumentTypeError("is empty; name a file or folder")
    return Path(text)


def whole_number(least: int, most: int = LARGEST_NUMBER) -> Callable[[str], int]:
    """Type of an option that takes whole numbers from `least` to `most`.

    The type raises ArgumentTypeError, as argparse wants it.
    """

    def whole(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"'{text}' is not a whole number") from None
        if value < least:
            raise argparse.ArgumentTypeError(f"{value} is less than {least}")
        if value > most:
            raise argparse.ArgumentTypeError(f"{value} is more than {most}")
        return value

    return whole


def real_number(wanted: str, least: float) -> Callable[[str], float]:
    """Type of an option that takes finite numbers from `least` on; `wanted` says in words what it is not otherwise.

    The type raises ArgumentTypeError, as argparse wants it.
    """

    def real(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not least <= value < math.inf:
            raise argparse.ArgumentTypeError(f"'{text}' is not {wanted}")
        return value

    return real


def say(console: Console, sentence: str, style: str = "") -> None:
    """Print one line as it is: no markup, no wrapping, whatever bytes a file name holds."""
    console.print(Text(plain(sentence), style=style), soft_wrap=True)


class Rate(ProgressColumn):
    """How many a second."""

    def render(self, task: Task) -> Text:
        """Text of the column."""
        return TaskProgressColumn.render_speed(task.finished_speed or task.speed)


def progress_bars(console: Console, *, disable: bool = False) -> Progress:
    """Bars with what is done, how fast and for how long still.

    Args:
        disable: draw none.
    """
    name, rest = TextColumn("{task.description}", markup=False), (BarColumn(), MofNCompleteColumn(), Rate())
    return Progress(name, *rest, TimeRemainingColumn(), console=console, disable=disable)
