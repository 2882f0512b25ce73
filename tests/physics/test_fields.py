"""Values from files are what their field's annotation says."""

from __future__ import annotations

import math
from typing import Literal

import pytest

from physics.fields import described, fits


@pytest.mark.parametrize(
    ("kind", "good", "bad"),
    [
        (float, [1, 1.5], [True, "1", None, [1.0], math.nan, math.inf, 10**400]),
        (int, [3], [3.0, True, "3"]),
        (str | None, ["a", None], [1, ["a"]]),
        (Literal["a", "b"], ["a", "b"], ["c", ["a"], {}]),
        (tuple[float, float], [[1, 2.0], (1, 2)], [[1.0], [1, 2, 3], [1, "2"], "ab", 2]),
        (tuple[str, ...], [[], ["a"], ("a", "b")], ["ab", [1], None]),
        (range(1, 3), [1, 2], [0, 3, 1.0, True, "1"]),
        (dict[str, int], [{}, {"a": 1}], [{"a": "1"}, {1: 1}, []]),
        ({"a": int, "b": str}, [{}, {"a": 1, "other": None}], [{"a": "1"}, {"a": 1, "b": 1}, [], None]),
    ],
)
def test_kinds_of_values(kind: object, good: list, bad: list):
    assert [fits(value, kind) for value in good] == [True] * len(good)
    assert [fits(value, kind) for value in bad] == [False] * len(bad)


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (str, "text"),
        (float | None, "a number or null"),
        (Literal["a", 2], "one of a, 2"),
        (tuple[int, ...], "[a whole number, …]"),
        (tuple[float, float] | bool, "[a number, a number] or true or false"),
    ],
)
def test_an_annotation_in_words(kind: object, words: str):
    assert described(kind) == words
