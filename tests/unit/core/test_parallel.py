"""Work that is shared among the processor's cores."""

import os
import threading
import time

import pytest
import scipy.linalg  # noqa: F401 - loads SciPy's BLAS, beside NumPy's
from threadpoolctl import threadpool_info, threadpool_limits

from core import parallel
from core.mapping import pipeline
from core.mapping.pipeline import build_map
from core.parallel import blas_in_one_thread, in_threads, usable_cores
from core.parameters import MapParameters
from core.scans.drive import MemoryDrive


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


def blas_threads():
    return {found["num_threads"] for found in threadpool_info() if found["user_api"] == "blas"}


@pytest.fixture
def two_threads():
    """Let BLAS have two threads, as a process without limits on a machine of two cores."""
    with threadpool_limits(2, user_api="blas"):
        yield
        assert blas_threads() == {2}


def test_blas_has_one_thread_within_the_block_and_as_many_as_before_behind_it(two_threads):
    def fail() -> None:
        with blas_in_one_thread():
            assert blas_threads() == {1}
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert blas_threads() == {2}


def test_the_first_of_two_blocks_that_ends_does_not_end_the_limit_of_the_other(two_threads):
    first, second = blas_in_one_thread(), blas_in_one_thread()
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    assert blas_threads() == {1}
    second.__exit__(None, None, None)


def test_a_map_is_built_with_one_thread_of_blas(two_threads, monkeypatch):
    def build(*arguments, **named):
        assert blas_threads() == {1}
        raise InterruptedError

    monkeypatch.setattr(pipeline, "build", build)
    with pytest.raises(InterruptedError):
        build_map(MemoryDrive("monday", []), MapParameters())
