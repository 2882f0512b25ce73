"""Compilation of the simulator's loops with numba, where it is installed."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable

try:
    import numba

    COMPILED = not numba.config.DISABLE_JIT
except ImportError:
    COMPILED = False
"""Whether the loops are compiled."""

# Contraction and reciprocals vectorise and lose nothing; reassociation would undo the displacement form, and
# assuming that no NaN occurs would hide one.
OPTIONS = {"fastmath": {"contract", "arcp", "nsz"}, "error_model": "numpy", "nogil": True}


class Kernel:
    """A compiled function that Python calls; its machine code is kept on disk for the next process where it can be."""

    def __init__(self, function: Callable) -> None:
        """Compile at the first call, which takes seconds, or a fraction of one where the disk has the code."""
        self.function = function
        functools.update_wrapper(self, function)
        try:
            self.run = numba.njit(function, cache=True, **OPTIONS)
        except RuntimeError:  # "cannot cache function: no locator available": no folder can be written
            self.run = numba.njit(function, **OPTIONS)

    def __call__(self, *arguments):
        """Run it; where the code can't be written to disk, it is compiled for this process only."""
        try:
            return self.run(*arguments)
        except OSError:
            self.run = numba.njit(self.function, **OPTIONS)
            return self.run(*arguments)


def kernel(function: Callable) -> Callable:
    """Decorator for compiled code that Python calls."""
    return Kernel(function) if COMPILED else function


def inlined(function: Callable) -> Callable:
    """Decorator for a part of kernels: copied into its callers, so that their loops can be vectorised."""
    return numba.njit(function, forceinline=True, **OPTIONS) if COMPILED else function


@functools.cache
def say_slow() -> None:
    """Tell once a process that the plain numpy or torch version runs."""
    warnings.warn(
        "numba isn't installed, so the simulator runs its plain version, up to a hundred times slower; "
        "pip install numba (the extra [fast]).",
        RuntimeWarning,
        stacklevel=3,
    )
