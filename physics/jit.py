"""Compilation of the simulator's loops with numba."""

import contextlib
import functools
import os
import tempfile
import threading
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import numba
import numpy as np

from palpate.common.provenance import code_digest

try:
    import fcntl
except ImportError:  # Windows; numba's own care has to do there
    fcntl = None

SETTINGS: Any = numba.config  # its attributes are set at run time
# Contraction and reciprocals vectorise and lose nothing; reassociation would undo the displacement form, and
# assuming that no NaN occurs would hide one.
OPTIONS: dict[str, Any] = {"fastmath": {"contract", "arcp", "nsz"}, "error_model": "numpy", "nogil": True}
_SETTING = threading.Lock()
"""Held while numba's setting is another: threads build kernels."""


class Kernel:
    """A compiled function that Python calls; its machine code is kept on disk for the next process where it can be."""

    def __init__(self, function: Callable) -> None:
        """Compile at the first call, which takes seconds, or a fraction of one where the disk has the code."""
        self.function = function
        functools.update_wrapper(self, function)
        self.folder = code_folder()
        self.run = self._compilable()
        self.known: set[tuple] = set()

    def __call__(self, *arguments):
        """Run it; where the code can't be written to disk, it is compiled for this process only."""
        kinds = tuple(_kind(argument) for argument in arguments)
        if kinds in self.known:
            return self.run(*arguments)
        with _alone(self.folder):
            try:
                result = self.run(*arguments)
            except OSError:
                self.folder = None
                self.run = self._compilable()
                result = self.run(*arguments)
        self.known.add(kinds)
        return result

    def _compilable(self) -> Callable:
        """The function as numba's, with its code kept in ``folder`` if there is one."""
        if self.folder is None:
            return numba.njit(self.function, **OPTIONS)
        with _SETTING:
            before, SETTINGS.CACHE_DIR = SETTINGS.CACHE_DIR, str(self.folder)
            try:
                return numba.njit(self.function, cache=True, **OPTIONS)
            except RuntimeError:  # "cannot cache function: no locator available"
                return numba.njit(self.function, **OPTIONS)
            finally:
                SETTINGS.CACHE_DIR = before


def _kind(argument) -> tuple:
    """What numba compiles anew for, as far as the arguments of one kernel differ in it."""
    if isinstance(argument, np.ndarray):
        return argument.dtype.char, argument.flags.c_contiguous, argument.flags.writeable
    if isinstance(argument, tuple):
        return tuple(_kind(value) for value in argument)
    return (type(argument),)


@functools.cache
def code_folder() -> Path | None:
    """Folder for machine code of exactly these sources, or None where nothing can be written.

    numba looks at a function's own file only, but constants and inlined parts come from others: a digest of all the
    simulator's sources names the folder, so that no code outlives them.
    """
    name = f"numba-{code_digest('kernels')}"
    own = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "palpate"
    chosen = [Path(SETTINGS.CACHE_DIR)] if SETTINGS.CACHE_DIR else []
    for place in (*chosen, Path(__file__).parent / "__pycache__", own):
        with contextlib.suppress(OSError):
            folder = place / name
            folder.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
            return folder
    return None


@contextlib.contextmanager
def _alone(folder: Path | None) -> Generator[None]:
    """Let one process at a time compile into a folder: others wait, and then find its code.

    numba writes its index and its code one after the other, so two writers could leave one's code under the other's
    signature.
    """
    with contextlib.ExitStack() as held:
        if folder is not None and fcntl is not None:
            with contextlib.suppress(OSError):
                lock = held.enter_context((folder / "lock").open("w"))
                fcntl.flock(lock, fcntl.LOCK_EX)
                held.callback(fcntl.flock, lock, fcntl.LOCK_UN)  # a fork would hold on to it after a mere close
        yield


def kernel(function: Callable) -> Callable:
    """Decorator for compiled code that Python calls."""
    return Kernel(function)


def inlined(function: Callable) -> Callable:
    """Decorator for a part of kernels: copied into its callers, so that their loops can be vectorised."""
    return numba.njit(function, forceinline=True, **OPTIONS)
