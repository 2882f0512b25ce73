"""Stages of a pipeline that overlap: an iterable is iterated in a thread of its own, a few items ahead."""

import contextlib
import threading
from collections.abc import Iterable, Iterator
from queue import Empty, Queue
from typing import TypeVar

Item = TypeVar("Item")
LOOK_AGAIN = 0.02
"""How often it is looked for whether a thread that was told to stop has done so [s]."""


def ahead(items: Iterable[Item], most: int) -> Iterator[Item]:
    """The items of an iterable in their order, while a thread goes on with it.

    An error of the iterable is raised in the place of its item. Where the caller stops early, the thread ends with the
    item that it is at, and the iterable is closed, before this generator is.

    Args:
        items: iterated in the thread alone.
        most: so many items wait at most, 1 or more.
    """
    waiting: Queue[tuple[bool, Item | BaseException | None]] = Queue(most)
    stopped = threading.Event()

    def iterate() -> None:
        try:
            for item in items:
                waiting.put((True, item))
                if stopped.is_set():
                    break
            waiting.put((False, None))
        except BaseException as error:  # whatever it is, the caller must not wait for ever
            waiting.put((False, error))

    thread = threading.Thread(target=iterate, daemon=True)
    thread.start()
    try:
        while True:
            more, item = waiting.get()
            if more:
                yield item  # ty: ignore[invalid-yield]  an item where there is more
            elif item is None:
                return
            else:
                raise item  # ty: ignore[invalid-raise]  else an error
    finally:
        stopped.set()
        while thread.is_alive():
            with contextlib.suppress(Empty):
                waiting.get(timeout=LOOK_AGAIN)  # so that it never waits for room
        close = getattr(items, "close", None)
        if close is not None:
            close()
