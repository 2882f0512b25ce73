"""Memory that is freed goes back to the system where the C library can do that."""

import ctypes
import os
import sys
from pathlib import Path

import pytest

from palpate.common.heap import share_heap, trim_heap


def resident() -> float:
    """Resident memory of this process [MB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "malloc_trim") or sys.platform != "linux", reason="no glibc")
def test_memory_that_was_freed_among_what_is_kept_is_given_back() -> None:
    blocks = [bytes(60_000) for _ in range(4000)]
    kept = blocks[::20]
    before = resident()
    del blocks
    trim_heap()
    assert resident() < before - 150
    assert len(kept) == 200


@pytest.mark.parametrize(("given", "then"), [(None, "1"), ("4", "4")])
def test_workers_share_one_heap_unless_told_otherwise(given, then, monkeypatch) -> None:
    monkeypatch.setenv("MALLOC_ARENA_MAX", given or "")
    if given is None:
        monkeypatch.delenv("MALLOC_ARENA_MAX")
    share_heap()
    assert os.environ["MALLOC_ARENA_MAX"] == then
