"""The heap of the C library, which keeps memory that is freed. Nothing happens where that isn't glibc."""

import contextlib
import ctypes
import os

_ABSENT = AttributeError, OSError, TypeError


def share_heap() -> None:
    """Let all threads share one heap, unless the environment says otherwise.

    glibc keeps one for each, and among pictures of megabytes most of them stays unused.
    """
    if "MALLOC_ARENA_MAX" not in os.environ:
        os.environ["MALLOC_ARENA_MAX"] = "1"  # of worker processes
        with contextlib.suppress(*_ABSENT):
            ctypes.CDLL(None).mallopt(-8, 1)  # M_ARENA_MAX


def trim_heap() -> None:
    """Give memory back that was freed; a fit frees hundreds of megabytes."""
    with contextlib.suppress(*_ABSENT):
        ctypes.CDLL(None).malloc_trim(0)
