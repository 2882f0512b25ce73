"""Values of settings that come from files: whether they are what a field's annotation asks for, and that in words."""

from __future__ import annotations

import sys
import types
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

WORDS: dict[Any, str] = {
    str: "text",
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    types.NoneType: "null",
    Ellipsis: "…",
}
LARGEST = sys.float_info.max
"""Of a number; a whole one may be longer than any."""


def fits(value: Any, kind: Any) -> bool:
    """Whether a value read from JSON is of a kind.

    Args:
        kind: an annotation (float takes whole numbers, but nothing that is not finite; tuple takes lists), a range of
            whole numbers, or a dictionary of the kinds of a mapping's fields, those that it has.
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
    if kind is float:
        return type(value) in (int, float) and abs(value) <= LARGEST
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
    return WORDS[kind]


def require_choices(settings: Any, group: str = "") -> None:
    """Raise a ValueError where a field of a dataclass that may be one of a few holds something else.

    Args:
        group: of the settings, for the sentence.
    """
    for name, kind in get_type_hints(type(settings)).items():
        if get_origin(kind) is Literal and not fits(getattr(settings, name), kind):
            raise ValueError(f"{group}{name} is {getattr(settings, name)!r}; give {described(kind)}.")
