"""Parts that the programs' terminals share: sentences, progress, and sizes of pictures."""

import re

from rich import progress
from rich.console import Console
from rich.text import Text

from palpate.common.doors import plain


def size_of(text: str) -> tuple[int, int] | None:
    """Return the width and height of a text such as 854x480; None where it is no size."""
    found = re.fullmatch("([0-9]+)x([0-9]+)", text)
    return None if found is None else (int(found[1]), int(found[2]))


def say(console: Console, sentence: str, style: str = "") -> None:
    """Print one line literally: without markup and wrapping, whatever bytes a file name holds."""
    console.print(Text(plain(sentence), style=style), soft_wrap=True)


def progress_bars(console: Console, *, disable: bool = False) -> progress.Progress:
    """Return progress bars with the time left.

    Args:
        console: console on which they appear.
        disable: whether to draw nothing.
    """
    name = progress.TextColumn("{task.description}", markup=False)
    columns = name, progress.BarColumn(), progress.MofNCompleteColumn(), progress.TimeRemainingColumn()
    return progress.Progress(*columns, console=console, disable=disable)
