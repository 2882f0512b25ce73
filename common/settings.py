"""Values of settings that come from files: whether they are what a field's annotation asks for, and that in words."""

import itertools
import math
import reprlib
import types
from collections.abc import Collection
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

WORDS: dict[Any, str] = {
    str: "text",
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    types.NoneType: "null",
    Ellipsis: "…",
}
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


MOST_LEVELS, MOST_VALUES = 16, 100_000
"""Of lists and mappings within each other, and of what lies in one of these levels."""


def sound(value: Any) -> bool:
    """Whether a value read from a file is of a reasonable size, with names in it that stand for others written out."""
    row = [value]
    for _ in range(MOST_LEVELS):
        if any(isinstance(each, (int, float)) and not abs(each) <= LARGEST for each in row):
            return False
        if any(isinstance(each, str) and "\0" in each for each in row):  # no name of a file
            return False
        held = (each.values() if isinstance(each, dict) else each for each in row if isinstance(each, (dict, list)))
        row = list(itertools.islice(itertools.chain.from_iterable(held), MOST_VALUES))
    return not row


def fits(value: Any, kind: Any) -> bool:
    """Whether a value read from JSON is of a kind.

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
    """An annotation in words, for a sentence that asks for such a value."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return " or ".join(map(described, inner))
    if origin is Literal:
        return "one of " + ", ".join(map(str, inner))
    if origin is tuple:
        return f"[{', '.join(map(described, inner))}]"
    return WORDS.get(kind, "a mapping of names to values")


def require_choices(settings: Any, group: str = "") -> None:
    """Raise a ValueError where a field of a dataclass that may be one of a few holds something else.

    Args:
        group: of the settings, for the sentence.
    """
    for name, kind in get_type_hints(type(settings)).items():
        if get_origin(kind) is Literal and not fits(getattr(settings, name), kind):
            raise ValueError(f"{group}{name} is {getattr(settings, name)!r}; give {described(kind)}.")


def require_numbers(
    settings: Any, *, positive: Collection[str] = (), not_negative: Collection[str] = (), group: str = ""
) -> None:
    """Raise a ValueError where a field, by its name, is not finite or too small; None is no number, and passes.

    Args:
        positive: fields that are above 0.
        not_negative: fields that are 0 or more.
        group: of the settings, for the sentence.
    """
    for name in (*positive, *not_negative):
        value, least = getattr(settings, name), "0 or more" if name in not_negative else "a positive number"
        if value is not None and not (math.isfinite(value) and (value > 0 or (value == 0 and name in not_negative))):
            raise ValueError(f"{group}{name} is {value}; give {least}.")


def require_between(settings: Any, group: str = "", /, **ranges: tuple[float, float]) -> None:
    """Raise a ValueError where a field lies outside its range, ends included; None is no number, and passes."""
    for name, (least, most) in ranges.items():
        value = getattr(settings, name)
        if value is not None and not least <= value <= most:
            raise ValueError(f"{group}{name} is {value}; give {least} to {most}.")


def require_ranges(settings: Any, group: str = "") -> None:
    """Raise a ValueError where a field lies outside the two numbers of its annotation, or is no number.

    Both ends of a field that is a range must lie inside, in their order; None is no number, and passes.
    """
    for name, kind in get_type_hints(type(settings), include_extras=True).items():
        limits = next((each.__metadata__ for each in (kind, *get_args(kind)) if get_origin(each) is Annotated), None)
        value = getattr(settings, name)
        ends = value if isinstance(value, tuple) else (value,)
        if limits and value is not None and not limits[0] <= ends[0] <= ends[-1] <= limits[1]:
            wanted = "a number" if len(ends) == 1 else "a low end up to a high end"
            raise ValueError(f"{group}{name} is {value}; give {wanted} within [{limits[0]:g}, {limits[1]:g}].")
