"""Values of settings that come from files: whether they are what a field's annotation asks for, and that in words."""

import functools
import itertools
import reprlib
import types
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

LARGEST = 1e15
"""No number that a file gives is farther from 0."""


class _Short(reprlib.Repr):
    """Representations of a few words; of a number beyond all use, that it is one."""

    def repr_int(self, x: int, level: int) -> str:
        return repr(x) if abs(x) <= LARGEST else f"a number beyond ±{LARGEST:g}"


_short = _Short()
_short.maxstring = _short.maxother = 60
shown = _short.repr
"""A value from a file for a sentence, which it leaves short however long, deep or circular the value is."""


def sound(value: Any) -> bool:
    """Return whether a value read from a file is of a reasonable size, with repeated names written out. Lists and
    mappings may nest 16 levels deep, with 100,000 values in a level."""
    row = [value]
    for _ in range(16):
        if any(isinstance(each, (int, float)) and not abs(each) <= LARGEST for each in row):
            return False
        if any(isinstance(each, str) and "\0" in each for each in row):  # no name of a file
            return False
        held = (each.values() if isinstance(each, dict) else each for each in row if isinstance(each, (dict, list)))
        row = list(itertools.islice(itertools.chain.from_iterable(held), 100_000))
    return not row


def fits(value: Any, kind: Any) -> bool:
    """Return whether a value read from JSON is of a kind.

    Args:
        kind: an annotation (float takes whole numbers, but nothing that is not finite; tuple takes lists), a range of
            whole numbers, or a dictionary of the kinds of a mapping's fields, those that it has. No number is beyond
            `LARGEST`.
    """
    if isinstance(kind, range):
        return type(value) is int and value in kind
    if isinstance(kind, dict):
        return isinstance(value, dict) and all(fits(value[name], kind[name]) for name in kind if name in value)
    origin, inner = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return any(fits(value, each) for each in inner)
    if origin is Literal:
        return value in inner
    if origin is tuple:
        if not isinstance(value, (list, tuple)):
            return False
        kinds = inner[:1] * len(value) if inner[-1] is Ellipsis else inner
        return len(value) == len(kinds) and all(map(fits, value, kinds))
    if origin is dict:
        return type(value) is dict and all(fits(name, inner[0]) and fits(value[name], inner[1]) for name in value)
    if kind in (int, float):
        return type(value) in (int, kind) and abs(value) <= LARGEST
    return kind is Any or type(value) is kind


def described(kind: Any) -> str:
    """Return an annotation in words, for a sentence that asks for such a value."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return " or ".join(map(described, inner))
    if origin is Literal:
        return "one of " + ", ".join(map(str, inner))
    if origin is tuple:
        return f"[{', '.join(map(described, inner))}]"
    words = {str: "text", int: "a whole number", float: "a number", bool: "true or false", types.NoneType: "null"}
    return "…" if kind is Ellipsis else words.get(kind, "a mapping of names to values")


Positive = Annotated[float, 1e-15, LARGEST]
"""A number above 0."""
NotNegative = Annotated[float, 0, LARGEST]
"""A number of 0 or more."""


@dataclass(frozen=True)
class Checked:
    """Base of frozen dataclasses whose values must be as their annotations say.

    `Literal` is a choice, `Annotated[float, 0, 1]` a number from 0 to 1, or a range within; None is always allowed.

    Args:
        group: of the settings, in front of their names in messages.
    """

    _group = ""

    def __init_subclass__(cls, group: str = "") -> None:
        cls._group = group or cls._group

    def __post_init__(self) -> None:
        """Raise a ValueError where a field holds something else."""
        for name, kind, ends in _constraints(type(self)):
            value = getattr(self, name)
            numbers = value if isinstance(value, tuple) else (value,)
            least, most = ends or (0, 0)
            if value is None or (fits(value, kind) if ends is None else least <= numbers[0] <= numbers[-1] <= most):
                continue
            wanted = described(kind)
            if ends is not None:
                start, end = ("a positive number", "up to") if least == 1e-15 else (f"{least:g}", "to")
                wanted = f"{start} {end} {most:g}" if most < LARGEST else f"{start}{' or more' * (end == 'to')}"
            raise ValueError(f"{self._group}{name} is {shown(value)}; give {wanted}.")


@functools.cache
def _constraints(kind: type[Any]) -> list[tuple[str, Any, Any]]:
    """Return names of a class's fields that are choices or limited numbers, their kinds, and ends of the latter."""
    plain, found = get_type_hints(kind), []
    for name, each in get_type_hints(kind, include_extras=True).items():
        parts = each, *get_args(each)
        ends = next((part.__metadata__ for part in parts if get_origin(part) is Annotated), None)
        if ends is not None or any(get_origin(part) is Literal for part in parts):
            found.append((name, plain[name], ends))
    return found
