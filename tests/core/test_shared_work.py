"""A function over several inputs in several threads."""

import threading
import time

import pytest

from depthmocap.core.shared_work import SharedWork


def test_results_come_in_order_and_the_thread_that_asks_helps() -> None:
    for threads in (1, 3):
        ran_in = set[int]()

        def add(a: int, b: int, ran_in: set[int] = ran_in) -> int:
            ran_in.add(threading.get_ident())
            time.sleep(0.002)
            return a + b

        assert SharedWork(threads).map(add, range(12), range(12)) == list(range(0, 24, 2))
        assert threading.get_ident() in ran_in and len(ran_in) == threads


def test_a_failure_is_raised_after_all_have_ended() -> None:
    ended = []

    def fail(place: int) -> None:
        time.sleep(0.002)
        ended.append(place)
        if place == 1:
            raise RuntimeError("the second")

    with pytest.raises(RuntimeError, match="the second"):
        SharedWork(2).map(fail, range(4))
    count = len(ended)
    time.sleep(0.01)
    assert len(ended) == count
    with pytest.raises(ValueError, match="shorter"):
        SharedWork(2).map(fail, [1], [])
