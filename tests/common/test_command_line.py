"""Sentences that are printed as they are, and sizes."""

import io

from rich.console import Console

from palpate.common.command_line import say, size_of


def test_a_sentence_is_printed_as_it_is() -> None:
    written = io.StringIO()
    say(Console(file=written, width=20), "[red]a\x1b[2Jb[/red] " + 30 * "c", "red")
    assert written.getvalue() == "[red]a\\x1b[2Jb[/red] " + 30 * "c" + "\n"


def test_sizes() -> None:
    assert size_of("854x480") == (854, 480)
    assert [size_of(text) for text in ("854", "854x", "854x480x3", "-854x480", "８５４x480", "854x4.8e2")] == [None] * 6
