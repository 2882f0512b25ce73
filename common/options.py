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
import math
import sys
import textwrap
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, Literal, NoReturn, get_args, get_origin, get_type_hints

import yaml

from palpate.common.doors import program
from palpate.common.files import read_file
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
    """Returns the name that is chosen without that option; its argument gives the value of any other option."""


class Parser(argparse.ArgumentParser):
    """A parser that states what is wrong in one sentence; its options are the fields of dataclasses.

    Args:
        module: of the program; empty = the program is called as it was typed.
        text: description for the help, whose first indented line is the example at the end.
    """

    def __init__(self, module: str, text: str | None) -> None:
        example = next((line.strip() for line in (text or "").splitlines() if line.startswith("    ")), "")
        ending = "Exit status: 0 done; 1 failed; 2 wrong usage; 130 interrupted."
        layout: dict[str, Any] = {"formatter_class": argparse.RawDescriptionHelpFormatter}
        layout |= {"description": text, "epilog": f"{ending}\n\nExample: {example}" if example else ending}
        super().__init__(program(module), allow_abbrev=False, argument_default=argparse.SUPPRESS, **layout)
        self.add_argument("--version", action="version", version=f"palpate {__version__}")
        self.fields: dict[str, dataclasses.Field[Any]] = {}
        self.others: Callable[[], dict[str, type[Any]]] = dict
        """Returns settings that aren't chosen, by what chooses them."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: error: {message}\n")

    def format_help(self) -> str:
        """Return the help, with the settings that aren't chosen at the end."""
        others = [f"  {choice}: {_title(kind)}" for choice, kind in self.others().items()]
        ending = ["Other choices, with --help for their options:", *others, "", self.epilog or ""]
        self.epilog = "\n".join(ending) if others else self.epilog
        return super().format_help()

    def declare(self, kind: type[Any], without: Sequence[str] = (), choice: str = "") -> None:
        """Add a group with an option for each field of a dataclass that has none yet.

        Args:
            kind: the dataclass.
            without: fields that are no options.
            choice: what chooses it.
        """
        texts, kinds = field_texts(kind), get_type_hints(kind, include_extras=True)
        group = self.add_argument_group(choice + _title(kind)) if self.fields else self
        for field in dataclasses.fields(kind):
            if field.init and not field.metadata.get("hidden") and field.name not in {*self.fields, *without}:
                self.fields[field.name] = field
                reading, flag = _reading(kinds[field.name], field.metadata), flag_of(field.name)
                if field.metadata.get("positional"):
                    reading |= {"nargs": "*", "action": "store"} if "nargs" in reading else {}
                    flag = field.name
                # `missing` names what is required, after a file of options.
                group.add_argument(flag, help=_help(field, texts), **reading).required = False
        required = [flag_of(name) for name in self.missing({}) if not self.fields[name].metadata.get("positional")]
        hints = [(name.upper(), field.metadata) for name, field in self.fields.items()]
        positional = [hint.get("metavar", name) for name, hint in hints if hint.get("positional")]
        self.usage = " ".join(["%(prog)s", *positional, *(f"{flag} VALUE" for flag in required), "[options]"])

    def missing(self, values: Mapping[str, Any]) -> list[str]:
        """Names of required options without a value."""
        return [name for name, field in self.fields.items() if _default(field) is ... and name not in values]

    def values(self, tokens: Sequence[str]) -> dict[str, Any]:
        """Values of the options that are given; ends the program where one is wrong."""
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
            for field in dataclasses.fields(kind):
                if not field.metadata.get("hidden") and field.name not in self.fields:
                    elsewhere.setdefault(flag_of(field.name), []).append(choice)
        if flag in elsewhere:
            return f"{flag} is an option of {' or '.join(elsewhere[flag])}."
        close = difflib.get_close_matches(flag, [*self._option_string_actions, *elsewhere], 1)
        return f"there is no option {flag}; " + (f"did you mean {close[0]}?" if close else "--help lists all.")

    def tokens(self, content: Mapping[str, Any]) -> list[str]:
        """Options of a file as they would be typed."""
        found, positional = [], []
        for key, value in content.items():
            flag, name = flag_of(str(key)), str(key).replace("-", "_")
            if value is None:
                continue
            if name not in self.fields:
                self.error(self.unknown(flag))
            values = [str(each) for each in (value if isinstance(value, list) else [value])]
            if self.fields[name].metadata.get("positional"):
                positional += values
            elif isinstance(value, bool):
                found.append(flag if value else f"--no-{flag[2:]}")
            elif values:
                found += [f"{flag}={values[0]}"] if len(values) == 1 else [flag, *values]
        return [*found, "--", *positional] if positional else found


def flag_of(name: str) -> str:
    """Return the option of a field, such as `--force-scale`."""
    return f"--{name.replace('_', '-')}"


def options(kind: type[Any], arguments: Sequence[str] | None, module: str, text: str | None) -> Any:
    """Fill a dataclass from the command line; ends the program where an option is wrong."""
    found = parse([kind], arguments, module, text)
    try:
        return filled(kind, vars(found))
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
        defaults: defaults of this program, of options that it has, in place of the fields' own.

    Returns:
        Every option's value by its field's name; that of `component` is the name that is chosen.
    """
    tokens, parser = sys.argv[1:] if arguments is None else list(arguments), Parser(module, text)
    for kind in kinds:
        parser.declare(kind, without)
    chosen, content = _chosen(parser, tokens, component, without) if component else ({}, {})
    values = parser.values(parser.tokens(content)) | parser.values(tokens) | chosen
    found = {name: _default(field) for name, field in parser.fields.items()} | dict(defaults or {}) | values
    found = {name: None if found[name] is ... else found[name] for name in parser.fields}
    if "print_config" in values:
        print(yaml.safe_dump({name: _plain(value) for name, value in found.items()}, sort_keys=False), end="")
        parser.exit()
    for name in parser.missing(values):
        hints = parser.fields[name].metadata
        asked = hints.get("metavar", name.upper()) if hints.get("positional") else flag_of(name)
        parser.error(f"{asked} is required; see --help.")
    return argparse.Namespace(**found)


def _chosen(
    parser: Parser, tokens: Sequence[str], component: Component, without: Sequence[str]
) -> tuple[dict[str, str], dict[str, Any]]:
    """Declare the options of the component that is chosen; return its name, and the content of `--config`."""
    first = argparse.ArgumentParser(add_help=False, allow_abbrev=False)

    def peek(name: str) -> Any:
        action = first.add_argument(flag_of(name))
        value = getattr(first.parse_known_args(tokens)[0], action.dest)
        return content.get(name) if value is None else value

    parser.add_argument("--config", metavar="FILE", help="YAML file of options; those on the command line count more")
    parser.add_argument("--print_config", action="store_true", help="print all options as such a file, and stop")
    content, flag = {}, flag_of(component.flag)
    content = _read(parser, Path(path)) if (path := peek("config")) else {}
    try:
        name = peek(component.flag) or component.default(peek)
        parser.declare(component.registry[name], without, f"{flag} {name}: ")
    except ValueError as error:
        parser.error(str(error))
    others = [other for other in component.registry.entries if other != name]
    parser.others = lambda: {f"{flag} {other}": component.registry[other] for other in others}
    return {component.flag: name}, content


def _read(parser: Parser, path: Path) -> dict[str, Any]:
    try:
        content = yaml.safe_load(read_file(path))
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        parser.error(f"{path} can't be read as YAML ({str(error).splitlines()[0]}); give a file as of --print_config.")
    if not isinstance(content, dict) or not sound(content):
        parser.error(f"{path} holds no options; give a file as of --print_config.")
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


def _default(field: dataclasses.Field[Any]) -> Any:
    """Default of a field; ... where it has none."""
    made = field.default_factory
    return field.default if field.default is not dataclasses.MISSING else ... if made is dataclasses.MISSING else made()


def _title(kind: type[Any]) -> str:
    """First line of a dataclass's documentation."""
    return (kind.__doc__ or "").split("\n")[0].rstrip(".")


def _plain(value: Any) -> Any:
    """Value of an option as YAML has it."""
    if isinstance(value, tuple | list):
        return [_plain(each) for each in value]
    return str(value) if isinstance(value, Path) else value


def _help(field: dataclasses.Field[Any], texts: Mapping[str, str]) -> str:
    text, default = texts.get(field.name, ""), _default(field)
    if "names" in field.metadata:
        text += f": {', '.join(field.metadata['names']())}"
    if not (isinstance(default, bool) or default in (None, (), ...) or "(default" in text):
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
    """Type of an option that takes numbers from `least` to `most`; raises ArgumentTypeError, as argparse wants it."""

    def read(text: str) -> Any:
        try:
            value = kind(text)
        except ValueError:
            value = math.nan
        if not least <= value <= most:
            ends = ((f" of {least:g} or more", least > -LARGEST), (f" of {most:g} or less", most < LARGEST))
            asked = " and".join(text for text, is_so in ends if is_so)
            raise argparse.ArgumentTypeError(f"'{text}' is not a {'whole ' * (kind is int)}number{asked}")
        return value

    return read
