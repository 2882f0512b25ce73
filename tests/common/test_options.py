"""Options of a program that are the fields of a dataclass."""

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest

from palpate.common.options import Component, field_texts, option, options, parse
from palpate.common.registry import Registry


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
    most: Annotated[float, 0, 1] | None = None
    """limit, 100 %"""
    count: Annotated[int, 3, 9] = 3
    """how many"""
    ends: tuple[float, float] = (0.0, 1.0)
    """range"""
    seen: Literal["press"] | None = None
    """frames"""
    sum: int = field(init=False, default=0)


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
        (["--most", "2"], "argument --most: '2' is not a number from 0 to 1"),
        (["--most", "nan"], "'nan' is not a number"),
        (["--count", "2"], "'2' is not a whole number from 3 to 9"),
        (["--count", "x"], "'x' is not a whole number"),
        (["--unit-name", "cm"], "cm"),
        (["--numbers", "one"], "one"),
        (["--seen", "one"], "invalid choice: 'one'"),
        (["--strange", "1"], "there is no option --strange; --help lists all."),
        (["--numbes", "1"], "there is no option --numbes; did you mean --numbers?"),
        (["--fine", "--most", "1", "2"], "2"),
        (["--output", ""], "is empty"),
        (["--output=--"], "an option is --; give its value or leave it out."),
    ],
)
def test_wrong_options_end_the_program(arguments, sentence, capsys: pytest.CaptureFixture) -> None:
    with pytest.raises(SystemExit) as stop:
        told(*arguments)
    assert stop.value.code == 2
    assert sentence in capsys.readouterr().err


# --- parts that are chosen by name ---


@dataclass(frozen=True)
class Given:
    """Common."""

    inputs: tuple[Path, ...] = option(positional=True)
    """files"""
    output: Path = option(metavar="DIR")
    """folder"""
    shape: str | None = option(None, choices=lambda: ["round", "square"])
    """which"""
    fine: bool = True
    """whether it is"""


@dataclass(frozen=True)
class Round:
    """A circle."""

    radius: float = 1.0
    """how far"""
    hidden: int = option(0, hidden=True)
    """of scripts"""


@dataclass(frozen=True)
class Square:
    """A square."""

    side: Annotated[float, 0, 9] = 2.0
    """how long"""


SHAPES = Registry("shape", "palpate.shapes", {"round": f"{__name__}:Round", "square": f"{__name__}:Square"})
SHAPE = Component("shape", SHAPES, lambda peek: "square" if peek("side") else "round")


def chosen(*arguments: str) -> dict[str, Any]:
    return vars(parse([Given], arguments, "tests.shapes", "Shapes.\n\n    shapes a b\n", component=SHAPE))


def test_options_are_those_of_the_part_that_is_chosen() -> None:
    usual = {"inputs": (Path("a"), Path("b")), "output": Path("x"), "fine": True}
    assert chosen("a", "b", "--output", "x") == usual | {"shape": "round", "radius": 1.0}
    assert chosen("a", "b", "--output", "x", "--side", "3") == usual | {"shape": "square", "side": 3.0}


def test_a_file_gives_what_the_command_line_does_not(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    with pytest.raises(SystemExit, match=r"^0$"):
        chosen("a", "--output", "x y", "--shape", "square", "--side", "3", "--no-fine", "--print_config")
    (tmp_path / "run.yaml").write_text(capsys.readouterr().out)
    told = chosen("--config", str(tmp_path / "run.yaml"), "--side", "4")
    assert told == {"inputs": (Path("a"),), "output": Path("x y"), "shape": "square", "fine": False, "side": 4.0}
    for text, said in (
        ("side: 10", "argument --side: '10' is not a number"),
        ("sides: 1", "there is no option --sides; did you mean --side?"),
        ("shape: oval", "there is no shape oval; choose round, square."),
        ("[1", "can't be read as YAML"),
        ("3", "holds no options"),
    ):
        (tmp_path / "run.yaml").write_text(f"{text}")
        shape = [] if text.startswith("shape") else ["--shape", "square"]
        with pytest.raises(SystemExit, match=r"^2$"):
            chosen("a", "--output", "x", *shape, "--config", str(tmp_path / "run.yaml"))
        shown = capsys.readouterr().err
        assert re.search(rf"run\.yaml:? {re.escape(said)}", shown)
    (tmp_path / "run.yaml").write_text("side: 1")
    with pytest.raises(SystemExit, match=r"^2$"):
        chosen("a", "--output", "x", "--side", "10", "--config", str(tmp_path / "run.yaml"))
    assert "run.yaml" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--side", "1", "--shape", "round"], "--side is an option of --shape square."),
        (["--hidden", "1"], "there is no option --hidden"),
        (["--shape", "oval"], "there is no shape oval; choose round, square."),
        (["--radus", "1"], "did you mean --radius?"),
    ],
)
def test_options_of_other_parts_are_refused(arguments, sentence, capsys: pytest.CaptureFixture) -> None:
    with pytest.raises(SystemExit, match=r"^2$"):
        chosen("a", "--output", "x", *arguments)
    assert sentence in capsys.readouterr().err


def test_what_is_required_is_named(capsys: pytest.CaptureFixture) -> None:
    for arguments, name in (["a"], "--output"), (["--output", "x"], "INPUTS"):
        with pytest.raises(SystemExit, match=r"^2$"):
            chosen(*arguments)
        assert f"{name} is required" in capsys.readouterr().err


def test_help_has_a_group_a_part_and_ends_with_an_example(capsys: pytest.CaptureFixture) -> None:
    with pytest.raises(SystemExit, match=r"^0$"):
        chosen("--help")
    printed = capsys.readouterr().out
    assert "--shape round: A circle:" in printed
    assert "  --shape square: A square\n" in printed
    assert printed.endswith("Example: shapes a b\n")
