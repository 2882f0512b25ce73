"""Values from files are what their field's annotation says."""

import math
import re
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import pytest

from palpate.common.settings import Checked, NotNegative, Positive, described, fits, shown, sound
from palpate.data.contact.geometry import GeometrySettings
from palpate.data.depth.normalise import DepthSettings
from palpate.data.depth.preset import DepthPreset
from palpate.data.masks.onnx import SegmentationSettings
from palpate.data.training.samples import SampleSettings


@pytest.mark.parametrize(
    ("kind", "good", "bad"),
    [
        (float, [1, 1.5, -1e12], [True, "1", None, [1.0], math.nan, math.inf, 10**400, 1.1e15]),
        (int, [3, 10**12], [3.0, True, "3", -(10**16), 10**5000]),
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


@pytest.mark.parametrize(
    ("kind", "choice", "said"),
    [
        (DepthSettings, {"bits": 12}, "depth.bits is 12; give one of 8, 16."),
        (DepthSettings, {"device": "gpu"}, "depth.device is 'gpu'; give one of auto, cpu, openvino, cuda."),
        (GeometrySettings, {"displacement": "guessed"}, "geometry.displacement is 'guessed'; give one of tracked, "),
        (SampleSettings, {"observation": "all"}, "samples.observation is 'all'; give one of final, trajectory."),
        (DepthPreset, {"name": "own", "kind": "depth"}, "kind is 'depth'; give one of metric, "),
        (SegmentationSettings, {"tool": (1,), "axes": "hwc"}, "axes is 'hwc'; give one of nchw, nhwc."),
    ],
)
def test_what_is_one_of_a_few_is_checked_from_python_too(kind: type, choice: dict, said: str):
    with pytest.raises(ValueError, match=re.escape(said)):
        kind(**choice)


def nested(levels: int, times: int = 1) -> list:
    """A list in a list, several times in each: few objects, and more to write than there is paper."""
    found: list = [1]
    for _ in range(levels):
        found = [found] * times
    return found


CIRCLE: list = []
CIRCLE.append(CIRCLE)


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("a" * 10**6, "'aaaaa"),
        (10**5000, "a number beyond ±1e+15"),
        ([10**5000], "[a number beyond ±1e+15]"),
        (CIRCLE, "[[["),
        (nested(40, times=2), "[[["),
        (nested(900), "[[["),
        ({"a": 1.5, "b": None}, "{'a': 1.5, 'b': None}"),
    ],
    ids=["long", "huge", "huge inside", "circle", "doubled", "deep", "plain"],
)
def test_a_value_is_shown_in_few_words(value: object, said: str):
    assert shown(value).startswith(said)
    assert len(shown(value)) < 1000


@pytest.mark.parametrize("value", [10**400, [math.nan], {"a": [math.inf]}, CIRCLE, nested(40, times=2), nested(900)])
def test_what_nobody_means_is_not_sound(value: object):
    assert not sound({"model": value})
    assert sound({"model": [1, 2.5, -(10**12), None, True, "a", {"b": nested(3, times=2)}]})


@dataclass(frozen=True)
class Board(Checked, group="the "):
    length: Positive = 1.0
    error: NotNegative = 0.0
    open: Positive | None = None
    side: Annotated[int, 8, 9] = 9
    ends: Annotated[tuple[float, float], 0, 5] = (1.0, 2.0)
    kind: Literal["oak", "elm"] | None = None


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ({"length": 0.0}, "the length is 0.0; give a positive number"),
        ({"length": math.inf}, "the length is inf; give a positive number"),
        ({"error": -1.0}, "the error is -1.0; give 0 or more"),
        ({"error": math.nan}, "the error is nan; give 0 or more"),
        ({"open": -1}, "the open is -1; give a positive number"),
        ({"side": 7}, "the side is 7; give 8 to 9"),
        ({"side": 10}, "is 10;"),
        ({"ends": (2.0, 1.0)}, r"the ends is \(2.0, 1.0\); give 0 to 5"),
        ({"kind": "ash"}, "the kind is 'ash'; give one of oak, elm"),
    ],
)
def test_values_that_are_not_as_annotated_are_refused(value: dict[str, Any], said: str):
    assert Board(side=8, kind="elm").side == 8
    with pytest.raises(ValueError, match=said):
        Board(**value)
