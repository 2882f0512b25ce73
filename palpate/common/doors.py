"""Begin and end of a program: quietly at Ctrl-C, and whatever its terminal can take.

A program calls `enter_door` before its slow imports, and `run_door` at its end, both only where it is the program.
"""

import contextlib
import importlib
import io
import os
import signal
import sys
from collections.abc import Callable, Generator
from types import ModuleType
from typing import Any, NoReturn

from palpate.common.heap import share_heap

INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it."""


class _Output(io.FileIO):
    """Standard output or error: what can't be written is dropped, and the first reason for it kept."""

    failure: OSError | None = None

    def write(self, data: Any, /) -> int:
        try:
            return super().write(data)
        except OSError as error:
            self.failure = self.failure or error
            return len(data)


def enter_door() -> None:
    """Let Ctrl-C end the program at once, and output never; letters a terminal lacks are escaped."""
    _quit_at_interrupt()
    share_heap()
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is not None:  # closed by the shell
            buffer = io.BufferedWriter(_Output(stream.fileno(), "w", closefd=False))
            buffered_by_line = stream.line_buffering or stream.write_through
            wrapper = io.TextIOWrapper(buffer, stream.encoding, "backslashreplace", line_buffering=buffered_by_line)
            setattr(sys, name, wrapper)


def run_door(main: Callable[[], int | None], interrupted: str = "Interrupted.") -> NoReturn:
    """Run a program and leave with its exit status, 130 after Ctrl-C, and at least 1 where its output was lost.

    A reader that has gone, as `head` does, has lost nothing that it wanted.

    Args:
        main: the program; it may handle Ctrl-C itself.
        interrupted: what is said where it does not.
    """
    if signal.getsignal(signal.SIGINT) is _quit:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with interruptible():
            status = main() or 0
    except SystemExit as stop:
        status = stop.code
    except KeyboardInterrupt:
        print(interrupted, file=sys.stderr)
        status = INTERRUPTED
    _quit_at_interrupt()
    for stream in (sys.stdout, sys.stderr):
        if stream is None:
            continue
        stream.flush()
        failure = getattr(getattr(stream.buffer, "raw", None), "failure", None)
        if failure is not None and not isinstance(failure, BrokenPipeError):
            print(f"Some output could not be written ({failure.strerror}).", file=sys.stderr)
            status = status or 1
    sys.exit(status)


@contextlib.contextmanager
def interruptible() -> Generator[None]:
    """Let Ctrl-C end what is done within as KeyboardInterrupt, wherever it lands.

    Compiled code in which it lands ends with an error of its own, mostly SystemError, which is no failure of the clip
    at hand.
    """
    try:
        yield
    except Exception as error:
        if by_interrupt(error):
            raise KeyboardInterrupt from error
        raise


def load_program(module: str) -> ModuleType:
    """Import a program's module, however slowly; Ctrl-C meanwhile ends the program at once and quietly.

    Raises:
        ModuleNotFoundError: there is none, or it needs a library that is not installed.
    """
    before = signal.getsignal(signal.SIGINT)
    _quit_at_interrupt()
    try:
        return importlib.import_module(module)
    finally:
        signal.signal(signal.SIGINT, before)


def program(module: str = "") -> str:
    """Return the name of the running program as it was typed, such as `infer.py`, `palpate infer` or `python -m
    MODULE`."""
    name = os.path.basename(sys.argv[0])
    return f"python -m {module}" if module and not name.startswith("palpate ") else name


def by_interrupt(error: BaseException | None) -> bool:
    """Return whether an interruption stands at the beginning of what went wrong."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error is not None


def plain(text: str) -> str:
    """Return a text on one line that does nothing to a terminal: control characters, as in file names, are shown as
    escapes."""
    text = text.encode("utf-8", "replace").decode()
    return "".join(x if x.isprintable() else " " if x.isspace() else x.encode("unicode_escape").decode() for x in text)


def _quit_at_interrupt() -> None:
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # else whoever started us wants it ignored
        signal.signal(signal.SIGINT, _quit)


def _quit(*_: object) -> NoReturn:
    os._exit(INTERRUPTED)
