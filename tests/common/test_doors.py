"""How programs end: at Ctrl-C whenever it comes, and on terminals that take no letter, no byte, or no more."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from palpate.common.doors import interruptible, plain
from tests.conftest import CHECKOUT

INTERRUPT = "os.kill(os.getpid(), signal.SIGINT)\n    time.sleep(20)"

SWALLOWED = f"""try:
        {INTERRUPT.replace(chr(10), chr(10) + "    ")}
    except KeyboardInterrupt:
        raise SystemError("a compiled function returned a result with an exception set")"""


def run(body: str, *, before: str = "", shell: str = "exec", **options: Any) -> subprocess.CompletedProcess:
    """Run a program of this body; `shell` says how it is started."""
    program = f"""
import atexit, os, signal, sys, time
sys.path.insert(0, {str(CHECKOUT)!r})
from palpate.common.doors import enter_door, run_door
enter_door()
{before}
def main():
    {body}
run_door(main, "Interrupted; nothing is lost.")
"""
    command = ["sh", "-c", f'{shell} "$0" -c "$1"', sys.executable, program]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | options
    return subprocess.run(command, **streams, timeout=60, check=False)


def test_the_exit_status_is_the_programs() -> None:
    assert [run(body).returncode for body in ("return 0", "pass", "return 1", "sys.exit(2)")] == [0, 0, 1, 2]
    failed = run("raise RuntimeError('a defect')")
    assert failed.returncode == 1
    assert b"RuntimeError: a defect" in failed.stderr


@pytest.mark.parametrize(
    ("program", "said"),
    [
        ({"body": INTERRUPT}, b"Interrupted; nothing is lost.\n"),
        ({"body": "pass", "before": INTERRUPT.replace("    ", "")}, b""),
        ({"body": "atexit.register(lambda: (os.kill(os.getpid(), signal.SIGINT), time.sleep(20)))"}, b""),
        ({"body": SWALLOWED}, b"Interrupted; nothing is lost.\n"),
    ],
    ids=["while it works", "while it imports", "while it ends", "while compiled code turns it into its own error"],
)
def test_an_interrupted_program_ends_with_130(program: dict[str, str], said: bytes) -> None:
    done = run(**program)
    assert (done.returncode, done.stdout, done.stderr) == (130, b"", said)


def test_an_interrupt_that_lands_in_compiled_code_is_one() -> None:
    """Half of those that hit the boxing of a kernel's results come out as SystemError."""
    boxed, seen = numba.njit(lambda count: [np.zeros(1) for _ in range(count)]), set()
    boxed(1)

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    @interruptible()
    def work() -> None:
        signal.setitimer(signal.ITIMER_REAL, 1e-3)
        while True:
            boxed(5)

    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        for _ in range(200):
            with pytest.raises(KeyboardInterrupt) as raised:
                work()
            seen.add(type(raised.value.__cause__))
    finally:
        signal.signal(signal.SIGALRM, before)
    assert seen <= {type(None), SystemError}


def test_other_errors_pass() -> None:
    with pytest.raises(SystemError, match="a defect"), interruptible():
        raise SystemError("a defect")


def test_an_ignored_interrupt_stays_ignored() -> None:
    done = run("os.kill(os.getpid(), signal.SIGINT); print('done')", shell="trap '' INT; exec")
    assert (done.returncode, done.stdout, done.stderr) == (0, b"done\n", b"")


@pytest.mark.parametrize(
    "environment", [{"PYTHONIOENCODING": "ascii"}, {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}]
)
def test_letters_that_a_terminal_lacks_are_escaped(environment: dict[str, str]) -> None:
    body = r"print('k_s \xb1 \u540d \udcff'); print('\u2026', file=sys.stderr)"
    done = run(body, env=os.environ | environment)
    assert (done.returncode, done.stdout, done.stderr) == (0, rb"k_s \xb1 \u540d \udcff" + b"\n", rb"\u2026" + b"\n")


def test_a_program_whose_output_was_lost_fails_in_one_sentence_when_all_else_is_done(tmp_path: Path) -> None:
    body = f"print('x' * 100_000, flush=True); open({str(tmp_path / 'done')!r}, 'w').close(); return {{}}"
    said = b"Some output could not be written (No space left on device).\n"
    with Path("/dev/full").open("wb") as full:
        done = run(body.format(0), stdout=full)
        assert (done.returncode, done.stderr) == (1, said)
        assert (tmp_path / "done").exists()
        assert run("print('x'); return 2", stdout=full).returncode == 2
        assert run("print('x'); print('y', file=sys.stderr)", stdout=full, stderr=full).returncode == 1


def test_a_reader_that_has_gone_and_a_closed_output_lose_nothing(tmp_path: Path) -> None:
    body = f"[print('x' * 100) for _ in range(10_000)]; open({str(tmp_path / 'done')!r}, 'w').close()"
    reading, writing = os.pipe()
    os.close(reading)
    done = run(body, stdout=writing)
    os.close(writing)
    assert (done.returncode, done.stderr) == (0, b"")
    assert (tmp_path / "done").exists()
    done = run("print('x')", shell="exec >&-; exec")
    assert (done.returncode, done.stderr) == (0, b"")


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("vidéo 肝臓 [red]", "vidéo 肝臓 [red]"),
        ("\x1b[31mred\x1b]0;title\x07", r"\x1b[31mred\x1b]0;title\x07"),
        ("\x9b31m\x08\x7f", r"\x9b31m\x08\x7f"),
        ("\u202eabc", r"\u202eabc"),
        ("one\ntwo\rthree\tfour", "one two three four"),
        ("clip\udcff", "clip?"),
    ],
)
def test_plain_text_does_nothing_to_a_terminal(text: str, shown: str) -> None:
    assert plain(text) == shown
