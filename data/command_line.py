"""What the programs' command lines share: types of options, and what is told while they work."""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskID,
    TaskProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from physics.doors import plain
from physics.fields import LARGEST

TOLD_SECONDS = 30.0
"""Time between two lines of progress where the output is no terminal [s]."""
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
    """Type of an option that takes numbers from `least` to LARGEST; `wanted` says in words what it is not otherwise.

    The type raises ArgumentTypeError, as argparse wants it.
    """

    def real(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not least <= value <= LARGEST:
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


class ToldProgress(Progress):
    """Progress where the output is no terminal, which shows no bars: a line now and then."""

    def __init__(self, *columns: ProgressColumn, **options: Any) -> None:
        super().__init__(*columns, **options)
        self._said = time.monotonic()

    def update(self, task_id: TaskID, **fields: Any) -> None:
        """As rich has it."""
        super().update(task_id, **fields)
        self._tell(task_id)

    def advance(self, task_id: TaskID, advance: float = 1) -> None:
        """As rich has it."""
        super().advance(task_id, advance)
        self._tell(task_id)

    def _tell(self, task_id: TaskID) -> None:
        if self.disable or time.monotonic() - self._said < TOLD_SECONDS:
            return
        self._said = time.monotonic()
        task = next(task for task in self.tasks if task.id == task_id)
        total = "?" if task.total is None else f"{task.total:g}"
        told = [f"{task.description}: {task.completed:g} of {total}", str(Rate().render(task))]
        if task.time_remaining is not None:
            told.append(f"{TimeRemainingColumn().render(task)} left")
        self.console.print(", ".join(filter(None, told)), markup=False)  # neither is known from one step


def progress_bars(console: Console, *, disable: bool = False) -> Progress:
    """Bars with what is done, how fast and for how long still; without a terminal a line every half minute.

    Args:
        disable: draw none.
    """
    name, rest = TextColumn("{task.description}", markup=False), (BarColumn(), MofNCompleteColumn(), Rate())
    kind = Progress if console.is_terminal else ToldProgress
    return kind(name, *rest, TimeRemainingColumn(), console=console, disable=disable)
