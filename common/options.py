"""Options of a program that are the fields of a dataclass, each with its documentation as its help."""

import argparse
import ast
import dataclasses
import inspect
import itertools
import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path
from types import NoneType
from typing import Any, Literal, get_args, get_origin, get_type_hints

from palpate.common.command_line import described_parser, path_option
from palpate.common.doors import program as as_typed


def options(kind: type[Any], arguments: Sequence[str] | None, program: str, documentation: str | None) -> Any:
    """A dataclass filled in from the command line; ends the program where an option is wrong.

    Options are written as `--clips 3`, `--suite clean noisy` (fields that are tuples) and `--camera`.
    """
    statuses = "0 done; 1 failed; 2 wrong usage; 130 interrupted"
    parser = described_parser(as_typed(program), documentation, statuses)
    add_options(parser, kind)
    given = sys.argv[1:] if arguments is None else arguments
    if any(each == "" or each.endswith("=") for each in given):
        parser.error("an option is empty, as of an unset variable of the shell; give its value or leave it out.")
    try:
        return filled(kind, vars(parser.parse_args(given)))
    except ValueError as error:
        parser.error(str(error))


def add_options(parser: argparse._ActionsContainer, kind: type[Any], without: Sequence[str] = ()) -> None:
    """Give a parser, or a group of one, an option for every field of a dataclass but those named."""
    texts, kinds = field_texts(kind), get_type_hints(kind)
    for field in dataclasses.fields(kind):
        if not field.init or field.name in without:
            continue
        text, required = texts[field.name], field.default is dataclasses.MISSING
        untold = isinstance(field.default, bool) or field.default in (None, ()) or "(default" in text
        if not (required or untold):
            shown = field.default if not isinstance(field.default, tuple) else " ".join(map(str, field.default))
            text += f" (default {shown})"
        option: dict[str, Any] = {"help": text.replace("%", "%%"), "default": argparse.SUPPRESS, "required": required}
        parser.add_argument(f"--{field.name.replace('_', '-')}", **option, **_reading(kinds[field.name]))


def filled(kind: type[Any], values: dict[str, Any]) -> Any:
    """A dataclass from those of some values that are its fields; what lacks has its default."""
    names = values.keys() & {field.name for field in dataclasses.fields(kind)}
    return kind(**{name: tuple(v) if isinstance(v := values[name], list) else v for name in names})


def field_texts(kind: type[Any]) -> dict[str, str]:
    """Documentation of every field of a dataclass and its bases, from their sources."""
    found, bases = {}, list[type[Any]](reversed(kind.__mro__))
    for base in bases:
        if not dataclasses.is_dataclass(base):
            continue
        [definition] = ast.parse(textwrap.dedent(inspect.getsource(base))).body
        for field, text in itertools.pairwise(ast.iter_child_nodes(definition)):
            if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr):
                found[ast.unparse(field.target)] = " ".join(ast.literal_eval(text.value).split())
    return found


def _reading(kind: Any) -> dict[str, Any]:
    """Return argparse's settings for a field of a kind."""
    inner = [each for each in get_args(kind) if each is not NoneType]
    if kind is bool:
        return {"action": argparse.BooleanOptionalAction}
    if get_origin(kind) is tuple and inner[-1] is Ellipsis:
        return {"action": "extend", "nargs": "+", **_reading(inner[0])}
    if get_origin(kind) is tuple:
        return {"nargs": len(inner), "type": inner[0], "metavar": ("LOW", "HIGH")}
    if get_origin(kind) is Literal:
        return {"choices": inner, "type": type(inner[0])}
    if inner:
        return _reading(inner[0])
    return {"type": path_option if kind is Path else kind, "metavar": kind.__name__.upper()}


def require_within(settings: Any, **ranges: tuple[float, float]) -> None:
    """Raise a ValueError where an option that is a number lies outside its range, ends included."""
    for name, (least, most) in ranges.items():
        value, option = getattr(settings, name), name.replace("_", "-")
        if value is not None and value < least:
            raise ValueError(f"--{option}: {value} is less than {least}.")
        if value is not None and value > most:
            raise ValueError(f"--{option}: {value} is more than {most}.")
