"""Options that take what they should, and sentences that are printed as they are."""

import argparse
import io
from pathlib import Path

import pytest
from rich.console import Console

from palpate.common.command_line import path_option, progress_bars, real_number, say, size_of, whole_number


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


def test_without_a_terminal_progress_is_told_now_and_then(monkeypatch: pytest.MonkeyPatch) -> None:
    text, clock = io.StringIO(), [1000.0]
    monkeypatch.setattr("time.monotonic", lambda: clock[0])
    with progress_bars(Console(file=text, width=200)) as bars:
        job = bars.add_task("clips [of many]", total=40)
        for _ in range(8):
            clock[0] += 10
            bars.advance(job)
    message = [line for line in text.getvalue().splitlines() if " of 40, " in line]
    assert [line.split(",")[0] for line in message] == [f"clips [of many]: {done} of 40" for done in (3, 6)]
    assert all("it/s" in line and "left" in line for line in message)


def test_what_one_step_does_not_tell_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    text, clock = io.StringIO(), [1000.0]
    monkeypatch.setattr("time.monotonic", lambda: clock[0])
    with progress_bars(Console(file=text, width=200)) as bars:
        job = bars.add_task("a slow clip", total=6)
        clock[0] += 40
        bars.update(job, completed=4)
    assert text.getvalue().splitlines()[0] == "a slow clip: 4 of 6"


def test_sizes() -> None:
    assert size_of("854x480") == (854, 480)
    assert [size_of(text) for text in ("854", "854x", "854x480x3", "-854x480", "８５４x480", "854x4.8e2")] == [None] * 6
