"""Compilation of the simulator's loops with numba."""

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba

from palpate.common.provenance import code_digest

try:
    import fcntl
except ImportError:  # Windows; numba's own care has to do there
    fcntl = None

# Contraction and reciprocals vectorise and lose nothing; reassociation would undo the displacement form, and
# assuming that no NaN occurs would hide one.
OPTIONS: dict[str, Any] = {"fastmath": {"contract", "arcp", "nsz"}, "error_model": "numpy", "nogil": True}
SETTINGS: Any = numba.config  # its attributes are set at run time
# numba compares a function's own file only: a digest of all sources keeps code from outliving their constants.
SETTINGS.CACHE_DIR = SETTINGS.CACHE_DIR or f"{Path(__file__).parent}/__pycache__/numba-{code_digest('kernels')}"


def kernel(function: Callable, **others: Any) -> Callable:
    """Compile a function that Python calls; its machine code is kept for the next process where numba finds a folder.

    One process at a time compiles: numba writes index and code one after the other.

    Args:
        function: compiled function.
        others: options of numba in place of those of OPTIONS.
    """
    try:
        compiled: Any = numba.njit(function, cache=True, **OPTIONS | others)
    except RuntimeError:  # "cannot cache function: no locator available"
        return numba.njit(function, **OPTIONS | others)
    compile_for, lock = compiled.compile, Path(compiled.stats.cache_path) / "lock"

    def alone(signature: Any) -> Any:
        with contextlib.ExitStack() as held:
            if fcntl is not None:
                file = held.enter_context(lock.open("w"))
                fcntl.flock(file, fcntl.LOCK_EX)
                held.callback(fcntl.flock, file, fcntl.LOCK_UN)  # a fork would hold on to it after a mere close
            return compile_for(signature)

    compiled.compile = alone
    return compiled


def inlined(function: Callable) -> Callable:
    """Compile a part of kernels: copied into its callers, so that their loops can be vectorised."""
    return numba.njit(function, forceinline=True, **OPTIONS)
