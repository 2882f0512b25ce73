"""Goldens: numbers of small parts of the groups; `python -m benchmarks.goldens` compares all."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from benchmarks import goldens

PARTS: dict[str, Callable[[Path], goldens.Values]] = {
    "network": lambda folder: goldens.inferred(folder, "", count=1),
    "recovery": lambda folder: goldens.recovered(folder, "press", ["clean"]),
    "online": goldens.followed,
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "group", ["network", *(pytest.param(name, marks=pytest.mark.acceptance) for name in ("recovery", "online"))]
)
def test_numbers_are_the_goldens(group: str, tmp_path: Path) -> None:
    values = goldens.rounded(PARTS[group](tmp_path))
    wanted = json.loads(goldens.GOLDENS.read_text(encoding="utf-8"))[group]
    assert len(values) > 10
    assert goldens.differences(values, {name: value for name, value in wanted.items() if name in values}) == []


def test_differences_are_named() -> None:
    values = goldens.rounded({"same": 1.00001, "other": 2.0, "word": "yes", "new": 1, "none": float("nan"), "no": ""})
    found = goldens.differences(values, {"same": 1.0, "other": 2.001, "word": "no", "gone": 3.0})
    assert found == [
        "other: 2.0, golden 2.001",
        "word: yes, golden no",
        "gone: missing, golden 3.0",
        "new: 1.0, golden missing",
    ]
