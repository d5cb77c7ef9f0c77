"""Work that is shared among the processor's cores."""

import os
import threading
import time

import pytest

from core import parallel
from core.parallel import in_threads, usable_cores


def test_results_are_in_the_order_of_the_items(monkeypatch):
    monkeypatch.setattr(parallel, "usable_cores", lambda: 3)

    def slow_first(item):
        time.sleep(0.05 if item == 0 else 0.0)
        return 2 * item

    assert in_threads(slow_first, range(5)) == [0, 2, 4, 6, 8]


def test_two_items_are_worked_on_at_the_same_time(monkeypatch):
    monkeypatch.setattr(parallel, "usable_cores", lambda: 2)
    both = threading.Barrier(2, timeout=10)
    assert sorted(in_threads(lambda _: both.wait(), [0, 1])) == [0, 1]


def test_one_item_needs_no_thread(monkeypatch):
    monkeypatch.setattr(parallel, "ThreadPoolExecutor", pytest.fail)
    assert in_threads(lambda _: threading.get_ident(), [0]) == [threading.get_ident()]
    assert in_threads(abs, []) == []


def test_an_error_of_one_is_that_of_all(monkeypatch):
    monkeypatch.setattr(parallel, "usable_cores", lambda: 2)
    with pytest.raises(ZeroDivisionError):
        in_threads(lambda item: 1 / item, [1, 0])


def test_there_is_a_core_where_affinity_is_not_known(monkeypatch):
    assert usable_cores() >= 1
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert usable_cores() == 1
