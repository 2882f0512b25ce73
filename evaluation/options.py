"""Options of an experiment: the fields of its dataclass, read from the command line."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from dataclasses import fields
from typing import Any, get_origin, get_type_hints

from jsonargparse import ArgumentParser, set_parsing_settings

from palpate.common.files import as_json


def options(kind: type[Any], arguments: Sequence[str] | None, program: str, documentation: str | None) -> Any:
    """A dataclass filled in from the command line; ends the program where an option is wrong.

    Options are written as `--clips 3`, `--suite clean noisy` (fields that are tuples of any length) and `--camera`.
    """
    set_parsing_settings(docstring_parse_attribute_docstrings=True)
    parser = _Parser(
        prog=f"python -m {program}",
        description=documentation,
        formatter_class=_Formatter,
        epilog="Exit status: 0 done; 1 failed; 2 wrong usage; 130 interrupted.",
    )
    parser.add_class_arguments(kind)
    given = sys.argv[1:] if arguments is None else arguments
    if any(each == "" or each.endswith("=") for each in given):
        parser.error("an option is empty, as of an unset variable of the shell; give its value or leave it out.")
    parsed = parser.parse_args(_spelt(kind, given))
    try:
        return kind(**{each.name: parsed[each.name] for each in fields(kind) if each.init})
    except ValueError as error:
        parser.error(str(error))


class _Formatter(argparse.RawDescriptionHelpFormatter, argparse.ArgumentDefaultsHelpFormatter):
    pass


class _Parser(ArgumentParser):
    def format_help(self, *arguments: Any, **options: Any) -> str:
        """As jsonargparse has it, with options spelt as a user writes them."""
        text = re.sub(r"--\w+", lambda option: option[0].replace("_", "-"), super().format_help(*arguments, **options))
        return text.replace("[ITEM,...]", "NAME …    ")


def require_within(settings: Any, **ranges: tuple[float, float]) -> None:
    """Raise a ValueError where an option that is a number lies outside its range, ends included."""
    for name, (least, most) in ranges.items():
        value, option = getattr(settings, name), name.replace("_", "-")
        if value is not None and value < least:
            raise ValueError(f"--{option}: {value} is less than {least}.")
        if value is not None and value > most:
            raise ValueError(f"--{option}: {value} is more than {most}.")


def _spelt(kind: type[Any], arguments: Sequence[str]) -> list[str]:
    """Arguments as jsonargparse reads them: one a field, several values as a list, and `true` for a bare flag."""
    kinds, found = get_type_hints(kind), list[str]()
    several: dict[str, list[str]] = {}
    for argument in arguments:
        name, equals, value = argument.removeprefix("--").partition("=")
        if argument.startswith("--"):
            latest, single = name.replace("-", "_"), not equals
            hint = kinds.get(latest)
            if get_origin(hint) is tuple:
                several.setdefault(latest, []).extend([value] if equals else [])
            elif hint is bool and single:
                found.append(f"--{latest}=true")
            elif hint is None:
                found.append(argument)
            else:
                found.append(f"--{latest}" + (f"={value}" if equals else ""))
        elif found and found[-1] == f"--{latest}":
            found[-1] += f"={argument}"
        elif several and latest in several:
            several[latest].append(argument)
        else:
            found.append(argument)
    return found + [f"--{name}={as_json(values)}" for name, values in several.items()]
