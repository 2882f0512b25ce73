"""Parts that the programs' command lines share: types of options, sentences and progress."""

import argparse
import math
import re
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

from rich import progress
from rich.console import Console
from rich.text import Text

from palpate.common.doors import plain
from palpate.common.settings import LARGEST

LARGEST_NUMBER = 2**63 - 1
"""Largest whole number of an option: larger ones are no counts, and no seeds of random generators."""


class Parser(argparse.ArgumentParser):
    """A parser that refuses `--option=--`, of which argparse makes an empty list."""

    def parse_args(self, *given: Any, **options: Any) -> Any:
        found = super().parse_args(*given, **options)
        if [] in vars(found).values():
            self.error("an option is --; give its value or leave it out.")
        return found


def described_parser(program: str, text: str | None, statuses: str) -> Parser:
    """A parser whose help shows a program's text as it stands, and its exit statuses."""
    how: dict[str, Any] = {"description": text, "formatter_class": argparse.RawDescriptionHelpFormatter}
    return Parser(prog=program, epilog=f"Exit status: {statuses}.", **how)


def add_listed(
    parser: argparse._ActionsContainer,
    listed: Mapping[str, Mapping[str, Any]],
    types: Mapping[str, Callable[[str], Any]],
    choices: Mapping[str, Collection[str]] | None = None,
    **words: object,
) -> None:
    """Give a parser options that a YAML file lists.

    Args:
        parser: gets them, or a group of one.
        listed: what `add_argument` takes, by option; types and choices by their names.
        types, choices: by name.
        words: stand for their braces in the help.
    """
    for name, option in listed.items():
        given: dict[str, Any] = {**option, "help": option["help"].format(**words)}
        given |= {key: of[option[key]] for key, of in (("type", types), ("choices", choices or {})) if key in option}
        parser.add_argument(name, **given)


def path_option(text: str) -> Path:
    """A path on the command line. An empty one, as of an unset shell variable, would be the whole working folder.

    Raises:
        ArgumentTypeError: the path is empty.
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


def real_number(wanted: str, least: float, most: float = LARGEST) -> Callable[[str], float]:
    """Type of an option that takes numbers from `least` to `most`; `wanted` describes them in the error message.

    The type raises ArgumentTypeError, as argparse wants it.
    """

    def real(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not least <= value <= most:
            raise argparse.ArgumentTypeError(f"'{text}' is not {wanted}")
        return value

    return real


def size_of(text: str) -> tuple[int, int] | None:
    """Width and height of a text such as 854x480; None where it is no size."""
    found = re.fullmatch("([0-9]+)x([0-9]+)", text)
    return None if found is None else (int(found[1]), int(found[2]))


def say(console: Console, sentence: str, style: str = "") -> None:
    """Print one line literally: without markup and wrapping, whatever bytes a file name holds."""
    console.print(Text(plain(sentence), style=style), soft_wrap=True)


def progress_bars(console: Console, *, disable: bool = False) -> progress.Progress:
    """Bars with progress and time left.

    Args:
        console: console on which they appear.
        disable: whether to draw nothing.
    """
    name = progress.TextColumn("{task.description}", markup=False)
    columns = name, progress.BarColumn(), progress.MofNCompleteColumn(), progress.TimeRemainingColumn()
    return progress.Progress(*columns, console=console, disable=disable)
