"""Work that the event loop does itself if it is known to be quick."""

import threading
from contextlib import contextmanager, nullcontext
from functools import partial

import pytest

from app.loading import NotLoaded
from app.quick_work import LastTimes, NotQuick, must_be_quick, quickly
from storage.catalog import NotKept


@pytest.fixture
def answer(monkeypatch):
    """Answer a query that takes so much CPU, and is of some kind, and return `True`."""
    spent, times = [0.0], LastTimes()
    monkeypatch.setattr("app.quick_work.time.thread_time", lambda: spent[0])

    def work(took_s=0.001, kind="fix"):
        with times.measured(kind):
            spent[0] += took_s
        return True

    return work


@pytest.mark.parametrize(("took_s", "is_quick"), [(0.0079, True), (0.0081, False)])
def test_work_is_quick_if_the_last_of_its_kind_took_less_than_8_ms(answer, took_s, is_quick):
    answer(0.001)
    answer(took_s)
    if is_quick:
        assert quickly(answer, nullcontext())
    else:
        with pytest.raises(NotQuick):
            quickly(answer, nullcontext())
        answer(0.001)
        assert quickly(answer, nullcontext())


def test_slow_work_is_remembered_for_several_quicker_ones_of_its_kind(answer):
    answer(0.040)
    quick_after = 0
    while True:
        answer(0.001)
        quick_after += 1
        try:
            quickly(answer, nullcontext())
        except NotQuick:
            continue
        break
    assert 4 <= quick_after <= 16


def test_the_first_work_of_a_kind_is_not_quick_whatever_others_took(answer):
    answer(0.001, "full view")
    with pytest.raises(NotQuick):
        quickly(partial(answer, 0.001, "partial view"), nullcontext())


def test_work_that_failed_says_nothing_of_the_time_of_the_next():
    times = LastTimes()

    def divide(by):
        with times.measured():
            return 1 // by

    with pytest.raises(ZeroDivisionError):
        divide(0)
    with pytest.raises(NotQuick):
        quickly(partial(divide, 1), nullcontext())


def test_kinds_that_clients_can_choose_take_a_limited_amount_of_memory():
    times = LastTimes()
    for kind in range(5000):
        with times.measured(kind):
            pass
        assert len(times._last_s) <= 1000
    assert 4999 in times._last_s


@pytest.mark.parametrize("needed", [NotKept(), NotLoaded("a map", lambda: None)])
def test_work_that_needs_a_query_or_has_to_load_something_is_not_quick(needed):
    def work():
        raise needed

    with pytest.raises(NotQuick):
        quickly(work, nullcontext())


def test_other_errors_of_quick_work_are_raised_as_they_are():
    with pytest.raises(ZeroDivisionError):
        quickly(lambda: 1 // 0, nullcontext())


def test_work_makes_no_query_while_it_has_to_be_quick_in_its_own_thread_only():
    inside, elsewhere = [], []

    @contextmanager
    def without_queries():
        inside.append(must_be_quick())
        yield

    def work():
        other = threading.Thread(target=lambda: elsewhere.append(must_be_quick()))
        other.start()
        other.join()
        return must_be_quick()

    assert quickly(work, without_queries())
    assert inside == [True]
    assert elsewhere == [False]
    assert not must_be_quick()
