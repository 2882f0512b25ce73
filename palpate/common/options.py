"""Command lines of programs: the fields of dataclasses, each with its documentation as its help.

A field is an option: `force_scale: Path | None = None` is `--force-scale PATH`. Its annotation gives the values that it
takes: `Annotated[float, 0, 1]` is a number from 0 to 1, `Literal` a choice, `tuple[int, ...]` several values. `option`
adds what an annotation can't say. A program whose component is chosen by name, such as `--estimator`, has the options
of that component's settings beside its own. Such a program reads options from `--config FILE` and writes them with
`--print_config`.
"""

import argparse
import ast
import dataclasses
import difflib
import inspect
import itertools
import json
import math
import sys
import textwrap
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, Literal, NoReturn, get_args, get_origin, get_type_hints

import yaml

from palpate.common.doors import program
from palpate.common.files import as_json, read_file
from palpate.common.provenance import __version__
from palpate.common.registry import Registry
from palpate.common.settings import LARGEST, sound


def option(default: Any = dataclasses.MISSING, **hints: Any) -> Any:
    """Declare a field with hints for the command line.

    Args:
        default: value without the option; MISSING = the option is required.
        hints: `metavar`; `choices`, or `names` that the help lists, each a function that returns them; `positional`;
            `hidden` from the command line; `setting`, what messages of other modules call it; `needs`, the attribute
            that the component must have.
    """
    return dataclasses.field(default=default, metadata=hints)


@dataclasses.dataclass(frozen=True)
class Component:
    """A part of a program that is chosen by name; the fields of its settings are options."""

    flag: str
    """Name of the option that chooses it."""
    registry: Registry
    """Settings by name."""
    default: Callable[[Callable[[str], Any]], str]
    """Function that returns the name chosen without that option; its argument gives the value of any other option."""


class Parser(argparse.ArgumentParser):
    """A parser that states what is wrong in one sentence; its options are the fields of dataclasses.

    Args:
        module: of the program; empty = the program is called as it was typed.
        text: description for the help, whose first indented line is the example at the end.
        defaults: in place of those of fields.
    """

    def __init__(self, module: str, text: str | None, defaults: Mapping[str, Any] | None = None) -> None:
        example = next((line.strip() for line in (text or "").splitlines() if line.startswith("    ")), "see above")
        ending = f"Exit status: 0 done; 1 failed; 2 wrong usage; 130 interrupted.\n\nExample: {example}"
        layout: dict[str, Any] = {"formatter_class": argparse.RawDescriptionHelpFormatter, "allow_abbrev": False}
        super().__init__(program(module), None, text, ending, argument_default=argparse.SUPPRESS, **layout)
        self.add_argument("--version", action="version", version=f"palpate {__version__}")
        self.hints: dict[str, Mapping[str, Any]] = {}
        """Hints of `option` by field."""
        self.known: dict[str, Any] = {}
        """Defaults by field; ... where it is required."""
        self.others: Callable[[], dict[str, type[Any]]] = dict
        """Function that returns settings that aren't chosen, by what chooses them."""
        self.origin = ""
        """Prefix of errors: the file that options are read from."""
        self._own = dict(defaults or {})

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: error: {self.origin}{message}\n")

    def format_help(self) -> str:
        """Return the help, with the settings that aren't chosen at the end."""
        others = "".join(f"  {choice}: {_title(kind)}\n" for choice, kind in self.others().items())
        if others:
            self.epilog = f"Other choices, with --help for their options:\n{others}\n{self.epilog}"
        return super().format_help()

    def declare(self, kind: type[Any], without: Sequence[str] = (), choice: str = "") -> None:
        """Add a group with an option for each field of a dataclass that has none yet.

        Args:
            kind: the dataclass.
            without: fields that are no options.
            choice: what chooses it.
        """
        texts, kinds = field_texts(kind), get_type_hints(kind, include_extras=True)
        group = self.add_argument_group(choice + _title(kind)) if self.hints else self
        for field in dataclasses.fields(kind):
            name, hints, made = field.name, field.metadata, field.default_factory
            if not field.init or hints.get("hidden") or name in {*self.hints, *without}:
                continue
            default = made() if made is not dataclasses.MISSING else field.default
            default = self._own.get(name, ... if default is dataclasses.MISSING else default)
            self.hints[name], self.known[name] = hints, default
            text = _help(texts.get(name, ""), hints, default)
            reading: dict[str, Any] = {"help": text, **_reading(kinds[name], hints)}
            if hints.get("positional") and "nargs" in reading:
                reading |= {"nargs": "*", "action": "store"}
            # What is required may stand in a file of options; `parse` names it.
            group.add_argument(name if hints.get("positional") else flag_of(name), **reading).required = False
        positional = [f"{hints.get('metavar', name)} " for name, hints in self.hints.items() if hints.get("positional")]
        self.usage = f"%(prog)s {''.join(positional)}[options]"

    def values(self, tokens: Sequence[str]) -> dict[str, Any]:
        """Return the values of the options that are given; ends the program where one is wrong."""
        for token in itertools.takewhile(lambda token: token != "--", tokens):
            flag = token.partition("=")[0]
            if token == "" or token.endswith("="):
                self.error("an option is empty, as of an unset variable of the shell; give its value or leave it out.")
            if token.startswith("--") and " " not in flag and flag not in self._option_string_actions:
                self.error(self.unknown(flag))
        found = vars(self.parse_args(tokens))
        if [] in found.values():
            self.error("an option is --; give its value or leave it out.")
        return {name: tuple(value) if isinstance(value, list) else value for name, value in found.items()}

    def unknown(self, flag: str) -> str:
        """Return a sentence about an option that doesn't exist."""
        elsewhere: dict[str, list[str]] = {}
        for choice, kind in self.others().items():
            for field in (field for field in dataclasses.fields(kind) if not field.metadata.get("hidden")):
                elsewhere.setdefault(flag_of(field.name), []).append(choice)
        if flag in elsewhere:
            return f"{flag} is an option of {' or '.join(elsewhere[flag])}."
        close = difflib.get_close_matches(flag, [*self._option_string_actions, *elsewhere], 1)
        return f"there is no option {flag}; " + (f"did you mean {close[0]}?" if close else "--help lists all.")

    def tokens(self, content: Mapping[str, Any]) -> list[str]:
        """Return the options of a file as they would be typed."""
        found, positional = [], []
        for name, value in content.items():
            flag, values = flag_of(name), [str(each) for each in (value if isinstance(value, list) else [value])]
            if value is None or values == []:
                continue
            if name not in self.hints:
                self.error(self.unknown(flag))
            if self.hints[name].get("positional"):
                positional += values
            elif isinstance(value, bool):
                found.append(flag if value else f"--no-{flag[2:]}")
            else:
                found += [f"{flag}={values[0]}"] if len(values) == 1 else [flag, *values]
        return [*found, "--", *positional] if positional else found


def flag_of(name: str) -> str:
    """Return the option of a field, such as `--force-scale`."""
    return f"--{name.replace('_', '-')}"


def options(kind: type[Any], arguments: Sequence[str] | None, module: str, text: str | None) -> Any:
    """Fill a dataclass from the command line; ends the program where an option is wrong."""
    try:
        return filled(kind, vars(parse([kind], arguments, module, text)))
    except ValueError as error:
        Parser(module, text).error(str(error))


def parse(
    kinds: Sequence[type[Any]],
    arguments: Sequence[str] | None,
    module: str,
    text: str | None,
    *,
    without: Sequence[str] = (),
    component: Component | None = None,
    defaults: Mapping[str, Any] | None = None,
) -> argparse.Namespace:
    """Read the command line; ends the program where an option is wrong.

    Args:
        kinds: dataclasses whose fields are options, a group each; the first group is shown first.
        arguments: of the command line; None = the program's own.
        module: of the program; empty = the program is called as it was typed.
        text: description for the help.
        without: fields that are no options here.
        component: part whose settings add their fields.
        defaults: in place of those of fields, where there are such.

    Returns:
        Every option's value by its field's name; that of `component` is the name that is chosen.
    """
    tokens, parser = sys.argv[1:] if arguments is None else list(arguments), Parser(module, text, defaults)
    for kind in kinds:
        parser.declare(kind, without)
    chosen, content = _chosen(parser, tokens, component, without) if component else ({}, {})
    given, parser.origin = parser.values(parser.tokens(content)), ""
    values = parser.known | given | parser.values(tokens) | chosen
    values.pop("config", None)
    if values.pop("print_config", False):
        known = {name: None if value is ... else value for name, value in values.items()}
        print(yaml.safe_dump(json.loads(as_json(known, default=str)), sort_keys=False), end="")
        parser.exit()
    for name in (name for name, value in values.items() if value is ...):
        hints = parser.hints[name]
        asked = hints.get("metavar", name.upper()) if hints.get("positional") else flag_of(name)
        parser.error(f"{asked} is required; see --help.")
    return argparse.Namespace(**values)


def _chosen(
    parser: Parser, tokens: Sequence[str], component: Component, without: Sequence[str]
) -> tuple[dict[str, str], dict[str, Any]]:
    """Declare the options of the component that is chosen; return its name, and the content of `--config`."""
    first, flag = argparse.ArgumentParser(add_help=False, allow_abbrev=False), flag_of(component.flag)
    content: dict[str, Any] = {}

    def peek(name: str) -> Any:
        action = first.add_argument(flag_of(name))
        value = getattr(first.parse_known_args(tokens)[0], action.dest)
        return content.get(name) if value is None else value

    parser.add_argument("--config", metavar="FILE", help="YAML file of options; those on the command line count more")
    parser.add_argument("--print_config", action="store_true", help="print all options as such a file, and stop")
    try:
        content |= _read(Path(path)) if (path := peek("config")) else {}
        name = peek(component.flag) or component.default(peek)
        parser.origin = f"{path}: " if name == content.get(component.flag) else ""
        parser.declare(component.registry[name], without, f"{flag} {name}: ")
    except ValueError as error:
        parser.error(str(error))
    parser.origin = f"{path}: " if content else ""

    def others() -> dict[str, type[Any]]:
        try:
            return {f"{flag} {each}": component.registry[each] for each in component.registry.entries if each != name}
        except ValueError as error:  # one that is broken
            parser.error(str(error))

    parser.others = others
    return {component.flag: name}, content


def _read(path: Path) -> dict[str, Any]:
    """Return the options in a file, or raise a ValueError."""
    try:
        content = yaml.safe_load(read_file(path))
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        raise ValueError(f"{path} can't be read as YAML ({str(error).splitlines()[0]}); see --print_config.") from error
    if not isinstance(content, dict) or not sound(content):
        raise ValueError(f"{path} holds no options; give a file as of --print_config.")
    return {str(name).replace("-", "_"): value for name, value in content.items()}


def filled(kind: type[Any], values: Mapping[str, Any]) -> Any:
    """Return a dataclass from those of some values that are its fields; others keep their defaults."""
    return kind(**{field.name: values[field.name] for field in dataclasses.fields(kind) if field.name in values})


def field_texts(kind: type[Any]) -> dict[str, str]:
    """Return the documentation of every field of a dataclass and its bases, from their sources."""
    found, bases = {}, list[type[Any]](reversed(kind.__mro__))
    for base in bases:
        if not dataclasses.is_dataclass(base):
            continue
        [definition] = ast.parse(textwrap.dedent(inspect.getsource(base))).body
        for field, text in itertools.pairwise(ast.iter_child_nodes(definition)):
            if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr):
                found[ast.unparse(field.target)] = " ".join(ast.literal_eval(text.value).split())
    return found


def _title(kind: type[Any]) -> str:
    """Return the first line of a dataclass's documentation."""
    return (kind.__doc__ or "").split("\n")[0].rstrip(".")


def _help(text: str, hints: Mapping[str, Any], default: Any) -> str:
    """Return the text of an option, with names that it takes, and its default."""
    if "names" in hints:
        text += f": {', '.join(hints['names']())}"
    if default is ... and not hints.get("positional"):
        text += " (required)"
    elif not (isinstance(default, bool) or default in (None, (), ...) or "(default" in text):
        text += f" (default {' '.join(map(str, default)) if isinstance(default, tuple) else default})"
    return text.replace("%", "%%")


def _reading(kind: Any, hints: Mapping[str, Any], ends: tuple[float, float] = (-LARGEST, LARGEST)) -> dict[str, Any]:
    """Return argparse's settings for a field of a kind, whose numbers lie within some ends."""
    inner = [each for each in get_args(kind) if each is not NoneType]
    if get_origin(kind) is Annotated:
        return _reading(inner[0], hints, (inner[1], inner[2]))
    if kind is bool:
        return {"action": argparse.BooleanOptionalAction}
    if get_origin(kind) is tuple and inner[-1] is Ellipsis:
        return {"action": "extend", "nargs": "+", **_reading(inner[0], hints, ends)}
    if get_origin(kind) is tuple:
        return {"nargs": len(inner), "type": _number(inner[0], *ends), "metavar": ("LOW", "HIGH")}
    if get_origin(kind) is Literal:
        return {"choices": inner, "type": type(inner[0])}
    if "choices" in hints:
        return {"choices": hints["choices"]()}
    if inner:
        return _reading(inner[0], hints, ends)
    reading = _number(kind, *ends) if kind in (int, float) else kind
    return {"type": reading, "metavar": hints.get("metavar", kind.__name__.upper())}


def _number(kind: type[Any], least: float, most: float) -> Callable[[str], Any]:
    """Return the type of an option that takes numbers from `least` to `most`; raises ArgumentTypeError, as argparse
    wants it."""

    def read(text: str) -> Any:
        try:
            value = kind(text)
        except ValueError:
            value = math.nan
        if not least <= value <= most:
            asked = f"{'whole ' * (kind is int)}number from {least:g} to {most:g}"
            raise argparse.ArgumentTypeError(f"'{text}' is not a {asked}")
        return value

    return read
