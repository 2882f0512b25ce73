"""Stages that overlap: what they give, in which order, and how they end."""

import itertools
import threading

import pytest

from palpate.common.ahead import ahead


def test_items_come_in_order_from_a_thread_of_their_own():
    seen = []

    def numbers():
        for number in range(50):
            seen.append(threading.get_ident())
            yield number

    assert list(ahead(ahead(numbers(), 3), 1)) == list(range(50))
    assert threading.get_ident() not in seen


def test_no_more_than_the_most_wait():
    taken = itertools.count()
    items = ahead(taken, 2)
    assert [next(items) for _ in range(10)] == list(range(10))
    items.close()
    # Ten were given, two waited, one was offered, and one more was made way for at the end.
    assert 10 <= next(taken) <= 14


def test_an_error_comes_in_the_place_of_its_item():
    def failing():
        yield 1
        raise ValueError("item 2 is bad.")

    items = ahead(failing(), 4)
    assert next(items) == 1
    with pytest.raises(ValueError, match="item 2"):
        next(items)


def test_a_caller_who_stops_leaves_no_thread_and_the_iterable_closed():
    closed = threading.Event()

    def endless():
        try:
            yield from itertools.count()
        finally:
            closed.set()

    before = threading.active_count()
    items = ahead(ahead(endless(), 1), 1)
    assert next(items) == 0
    items.close()
    assert closed.is_set()
    assert threading.active_count() == before
