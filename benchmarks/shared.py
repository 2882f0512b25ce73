"""What all benchmarks need: a command line whose help is the module's text, timing, a Markdown table, the machine."""

import argparse
import itertools
import os
import platform
import time
from collections.abc import Callable, Iterable, Sequence
from datetime import date
from typing import TypeVar

Result = TypeVar("Result")


def command_line(documentation: str | None) -> argparse.ArgumentParser:
    """Command line of the benchmark with this module documentation."""
    return argparse.ArgumentParser(description=documentation, formatter_class=argparse.RawDescriptionHelpFormatter)


def timed(work: Callable[..., Result], *arguments: object) -> tuple[Result, float]:
    """What a call returns, and how long it took [ms]."""
    start = time.perf_counter()
    result = work(*arguments)
    return result, 1e3 * (time.perf_counter() - start)


def print_table(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a Markdown table, each row as soon as it is there."""
    for cells in itertools.chain([columns, ["---"] * len(columns)], rows):
        print(f"| {' | '.join(map(str, cells))} |", flush=True)


def machine() -> str:
    """Where and when this is measured."""
    return f"{os.cpu_count()} cores {platform.machine()}, {date.today()}"
