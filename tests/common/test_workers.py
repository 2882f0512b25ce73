"""Processes that share out tasks and end when nobody wants more."""

import multiprocessing
import os
import signal
import time
from concurrent.futures import CancelledError
from concurrent.futures.process import BrokenProcessPool

import cv2
import pytest

from palpate.common.workers import WorkerLost, background_process, run_tasks


def square(value: int) -> int:
    return value * value


def late_first(value: int) -> int:
    time.sleep(0.3 if value == 0 else 0)
    return value * value


def limits(_: int) -> tuple[str, int]:
    return os.environ.get("OMP_NUM_THREADS", ""), cv2.getNumThreads()


def sees_interrupts(_: int) -> bool:
    return signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def die(_: int) -> None:
    os._exit(1)


@pytest.mark.parametrize("workers", [0, 2])
def test_every_task_is_done_in_order_where_that_is_asked_for(workers):
    assert sorted(run_tasks(square, range(5), workers)) == [0, 1, 4, 9, 16]
    assert list(run_tasks(late_first, range(6), workers, ordered=True)) == [0, 1, 4, 9, 16, 25]


def test_workers_have_one_native_thread_and_the_parent_keeps_its_own(monkeypatch):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    assert set(run_tasks(limits, range(2), 2)) == {("1", 1)}
    assert set(run_tasks(limits, range(2), 2, threads=3)) == {("3", 3)}
    assert "OMP_NUM_THREADS" not in os.environ


def children_end() -> bool:
    """Wait until no process is left.

    Not by joining them: the pool's own thread does so too, and whoever is slower sees a child that seems alive.
    """
    deadline = time.monotonic() + 10
    while multiprocessing.active_children() and time.monotonic() < deadline:
        time.sleep(0.01)
    return multiprocessing.active_children() == []


def test_leaving_early_ends_the_workers():
    results = run_tasks(square, range(50), 2)
    next(results)
    results.close()
    assert children_end()


def test_workers_never_see_an_interrupt_and_the_parent_does():
    assert list(run_tasks(sees_interrupts, range(2), 2)) == [False, False]
    assert sees_interrupts(0)


def test_a_killed_worker_is_told():
    with pytest.raises(WorkerLost, match="fewer workers or jobs"):
        list(run_tasks(die, range(3), 2))


def test_a_background_process_gives_way_and_ends_with_its_block():
    with background_process() as process:
        assert process.submit(square, 3).result() == 9
        assert process.submit(os.nice, 0).result() == 19
        assert process.submit(sees_interrupts, 0).result() is False
        long = process.submit(time.sleep, 60)
    assert children_end()
    assert os.nice(0) == 0
    with pytest.raises((BrokenProcessPool, CancelledError)):
        long.result()
