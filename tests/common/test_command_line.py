"""Options that take what they should, and sentences that are printed as they are."""

import argparse
import io
from pathlib import Path

import pytest
from rich.console import Console

from palpate.common.command_line import described_parser, path_option, real_number, say, size_of, whole_number


def test_an_empty_path_is_refused() -> None:
    assert path_option("a b") == Path("a b")
    with pytest.raises(argparse.ArgumentTypeError, match="is empty; name a file or folder"):
        path_option("")


@pytest.mark.parametrize(
    ("text", "said"), [("2", "2 is less than 3"), ("10", "10 is more than 9"), (str(-(10**30)), "is less than 3")]
)
def test_whole_numbers_have_ends(text: str, said: str) -> None:
    assert [whole_number(3, 9)(each) for each in ("3", "9")] == [3, 9]
    with pytest.raises(argparse.ArgumentTypeError, match=said):
        whole_number(3, 9)(text)
    with pytest.raises(argparse.ArgumentTypeError, match="'x' is not a whole number"):
        whole_number(3, 9)("x")


@pytest.mark.parametrize("text", ["x", "nan", "inf", "-inf", "0.4", "1e308"])
def test_real_numbers_are_finite_and_have_a_lower_end(text: str) -> None:
    width = real_number("a width; give 0.5 or more", 0.5)
    assert [width("0.5"), width("1e15")] == [0.5, 1e15]
    with pytest.raises(argparse.ArgumentTypeError, match=f"'{text}' is not a width; give 0.5 or more"):
        width(text)


def test_a_sentence_is_printed_as_it_is() -> None:
    written = io.StringIO()
    say(Console(file=written, width=20), "[red]a\x1b[2Jb[/red] " + 30 * "c", "red")
    assert written.getvalue() == "[red]a\\x1b[2Jb[/red] " + 30 * "c" + "\n"


def test_an_option_that_is_two_dashes_is_refused(capsys: pytest.CaptureFixture) -> None:
    parser = described_parser("program", "", "")
    parser.add_argument("--path", type=Path)
    with pytest.raises(SystemExit):
        parser.parse_args(["--path=--"])
    assert "an option is --; give its value or leave it out." in capsys.readouterr().err


def test_sizes() -> None:
    assert size_of("854x480") == (854, 480)
    assert [size_of(text) for text in ("854", "854x", "854x480x3", "-854x480", "８５４x480", "854x4.8e2")] == [None] * 6
