"""Stages of a pipeline that overlap: an iterable is iterated in a thread of its own, a few items ahead."""

from collections import deque
from collections.abc import Generator, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

Item = TypeVar("Item")


def ahead(items: Iterable[Item], most: int) -> Generator[Item]:
    """Yield the items of an iterable in their order, while a thread goes on with it.

    An error of the iterable is raised in the place of its item. Where the caller stops early, the thread ends with the
    item that it is at, and the iterable is closed, before this generator is.

    Args:
        items: iterated in the thread alone.
        most: so many items wait at most, 1 or more.
    """
    source, end, thread = iter(items), object(), ThreadPoolExecutor(1)
    try:
        waiting = deque[Any](thread.submit(next, source, end) for _ in range(most))
        while (item := waiting.popleft().result()) is not end:
            waiting.append(thread.submit(next, source, end))
            yield item
    finally:
        thread.shutdown(cancel_futures=True)
        close = getattr(items, "close", None)
        if close is not None:
            close()
