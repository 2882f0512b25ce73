"""Options of a program that are the fields of a dataclass."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import pytest

from palpate.common.options import field_texts, options, require_within


@dataclass(frozen=True)
class Written:
    output: Path
    """folder"""


@dataclass(frozen=True)
class Squares(Written):
    numbers: tuple[int, ...] = (2, 4)
    """some of
    them"""
    unit_name: Literal["m", "mm"] = "m"
    """of them"""
    fine: bool = False
    """whether they are"""
    most: float | None = None
    """limit, 100 %"""
    ends: tuple[float, float] = (0.0, 1.0)
    """range"""
    seen: Literal["press"] | None = None
    """frames"""
    sum: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        require_within(self, most=(0, 1))


def told(*arguments: str) -> Squares:
    return options(Squares, ["--output", "x", *arguments], "tests.squares", "Squares.")


def test_options_are_the_fields_of_the_dataclass_and_its_bases(capsys: pytest.CaptureFixture) -> None:
    assert told() == Squares(Path("x"))
    every = told("--numbers", "1", "2", "--fine", "--most=0.5", "--unit-name", "mm", "--numbers", "3")
    assert (every.numbers, every.fine, every.most, every.unit_name) == ((1, 2, 3), True, 0.5, "mm")
    assert told("--seen", "press").seen == "press"
    assert told("--ends", "-2", "3").ends == (-2.0, 3.0)
    with pytest.raises(SystemExit) as stop:
        told("--help")
    assert stop.value.code == 0
    printed = capsys.readouterr().out
    for text in ("--unit-name {m,mm}", "some of them (default 2 4)", "limit, 100 %"):
        assert text in printed
    assert field_texts(Squares)["output"] == "folder"


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--most", "2"], "--most: 2.0 is more than 1"),
        (["--unit-name", "cm"], "cm"),
        (["--numbers", "one"], "one"),
        (["--seen", "one"], "invalid choice: 'one'"),
        (["--strange", "1"], "--strange"),
        (["--fine", "--most", "1", "2"], "2"),
        (["--output", ""], "is empty"),
    ],
)
def test_wrong_options_end_the_program(arguments, sentence, capsys: pytest.CaptureFixture) -> None:
    with pytest.raises(SystemExit) as stop:
        told(*arguments)
    assert stop.value.code == 2
    assert sentence in capsys.readouterr().err
