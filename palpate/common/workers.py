"""Tasks in processes of few native threads each: many independent ones, or some that give way to all else."""

import contextlib
import multiprocessing
import os
import signal
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from palpate.common.doors import interruptible

Task = TypeVar("Task")
Result = TypeVar("Result")
LIMITS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")
"""Variables that say how many native threads libraries use, which read them when they are loaded."""


class WorkerLost(RuntimeError):
    """A worker process ended by itself; the message is a sentence."""


def run_tasks(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    workers: int | None,
    *,
    ordered: bool = False,
    threads: int = 1,
) -> Iterator[Result]:
    """Yield results of all tasks, in the order in which they are done.

    Leaving the loop early, as Ctrl-C does, ends the workers at once.

    Args:
        function: importable by its name.
        workers: processes; 0 = in this one, one after the other; None = one for each of the machine's cores.
        ordered: in the order of the tasks instead.
        threads: native threads of each process.

    Raises:
        WorkerLost: a process was killed, most likely for want of memory.
    """
    if workers == 0 or not tasks:
        with interruptible():
            yield from map(function, tasks)
        return
    with _processes(min(workers or os.cpu_count() or 1, len(tasks))) as pool:
        try:
            with _as_workers_start(threads):
                futures = [pool.submit(function, task) for task in tasks]
            for future in futures if ordered else as_completed(futures):
                yield future.result()
            pool.shutdown()
        except BrokenProcessPool as error:
            lost = "A worker process was killed, maybe for want of memory; use fewer workers or jobs."
            raise WorkerLost(lost) from error


@contextlib.contextmanager
def background_process() -> Generator[Executor]:
    """Start a process that runs tasks only while nothing else needs the cores (not on Windows, which has no `nice`).

    Its `submit` takes functions that are importable by their names. Leaving the block ends it at once.
    """
    with _processes(1) as pool:
        with _as_workers_start(1):
            pool.submit(getattr(os, "nice", abs), 19)
        yield pool


@contextlib.contextmanager
def _processes(count: int) -> Generator[ProcessPoolExecutor]:
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(count, mp_context=multiprocessing.get_context("spawn"))
    try:
        yield pool
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()
            process.join()  # what it left can be cleared when it has gone


@contextlib.contextmanager
def _as_workers_start(threads: int) -> Generator[None]:
    """Let processes that start now use so many native threads, which libraries read when they are loaded.

    And let them never see Ctrl-C, not even while they import: this one decides what comes of it.
    """
    before = dict(os.environ)
    os.environ.update(dict.fromkeys(LIMITS, str(threads)))
    signals = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, signals)
        for name in LIMITS:
            del os.environ[name]
        os.environ.update(before)
