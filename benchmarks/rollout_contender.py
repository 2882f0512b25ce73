"""A contender of `benchmarks.rollout` as the benchmark sees it: a process that is asked for times and memory."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import statistics
import time
from pathlib import Path
from unittest import mock

import numpy as np

from benchmarks.rollout_worker import serve

SLOW = 5.0
"""First call from which on memory is measured together with the first time, and turn after which none follows [s]."""
SAME_TRAJECTORY, SAME_GRADIENT = 1e-3, 1e-2
"""Largest difference from the baseline's, relative to the latter's peak: single precision over 200 steps."""


def title(name: tuple[str, str, int]) -> str:
    """A contender's name in words."""
    return f"{name[0]} {name[1]}, {name[2]} thread{'s' if name[2] > 1 else ''}"


class Failure(RuntimeError):
    """A contender can't go on."""

    def __init__(self, name: tuple[str, str, int], reason: str) -> None:
        """Name it and say why."""
        super().__init__(f"{title(name)}: {reason}")
        self.reason = reason


class Contender:
    """One contender's process."""

    def __init__(self, name: tuple[str, str, int], setting: tuple, cache: Path) -> None:
        """Start it and let it make its first calls.

        Raises:
            Failure: it failed.
        """
        self.name = name
        self.forward: list[float] = []
        self.total: list[float] = []
        self.spent, self.longest = 0.0, 0.0
        self.peak: float | None = None
        context = multiprocessing.get_context("spawn")
        self.connection, other = context.Pipe()
        own = cache / "-".join(map(str, name))
        # Before it starts: a spawned process imports this module, and numba with it, before it runs anything.
        self.process = context.Process(target=serve, args=(other, name, setting), daemon=True)
        with mock.patch.dict(os.environ, NUMBA_CACHE_DIR=str(own / "numba"), WARP_CACHE_PATH=str(own / "warp")):
            self.process.start()
        other.close()
        self.vertices, self.first_call, self.trajectory, self.gradient = self._receive()

    def _receive(self):
        try:
            answer = self.connection.recv()
        except (EOFError, OSError):
            self.process.join(10)
            answer = _ending(self.process.exitcode)
        if isinstance(answer, str):
            raise Failure(self.name, answer)
        return answer

    def ask(self, what: str):
        """Let it measure.

        Raises:
            Failure: it failed.
        """
        with contextlib.suppress(OSError):  # where it ended, there is no answer, which says why
            self.connection.send(what)
        return self._receive()

    def wants_turn(self, patience: float) -> bool:
        """Whether it is timed once more: once in any case, then until its turns took `patience` or one is slow [s]."""
        return not self.forward or (self.spent < patience and self.longest <= SLOW)

    def turn(self) -> None:
        """Time it once; whoever is slow has its memory measured on that occasion, not in a turn of its own."""
        start = time.perf_counter()
        both = self.first_call > SLOW and not self.forward
        peak, forward, total = self.ask("memory and times" if both else "times")
        self.peak = peak if both else self.peak
        self.longest = max(self.longest, took := time.perf_counter() - start)
        self.spent += took
        self.forward.append(forward)
        if total is not None:
            self.total.append(total)

    def require_same(self, baseline: Contender) -> None:
        """Refuse to time what computes something else.

        Raises:
            Failure: trajectory or gradient differ from the baseline's.
        """
        for what, seen, expected, allowed in (
            ("trajectory", self.trajectory, baseline.trajectory, SAME_TRAJECTORY),
            ("gradient", self.gradient, baseline.gradient, SAME_GRADIENT),
        ):
            if seen is None:
                continue
            difference = (np.abs(seen - expected) / np.abs(expected).max()).max()
            if not difference <= allowed:
                raise Failure(self.name, f"its {what} differs by {difference:.1e}")

    def row(self, batch: int) -> dict[str, object]:
        """Medians and spreads; no ratios yet."""
        if self.first_call <= SLOW:
            self.peak = self.ask("memory and times")[0]
        row: dict[str, object] = dict(zip(("backend", "variant", "threads"), self.name, strict=True))
        row |= {"batch": batch, "vertices": self.vertices // batch, "peak_mb": self.peak}
        row |= {"first_call_s": self.first_call, "rounds": len(self.forward)}
        for key, values in (("forward", self.forward), ("total", self.total)):
            if values:
                row |= {f"{key}_ms": statistics.median(values)}
                row |= {f"{key}_min_ms": min(values), f"{key}_max_ms": max(values)}
        return row

    def stop(self) -> None:
        """End the process."""
        with contextlib.suppress(OSError):  # it may have ended before
            self.connection.send("stop")
        self.process.join(10)
        self.process.terminate()
        self.process.join(10)


def _ending(status: int | None) -> str:
    """How a process ended that gave no answer."""
    if status == -signal.SIGKILL:
        return "it was killed, probably for lack of memory"
    return f"it ended with status {status}"
