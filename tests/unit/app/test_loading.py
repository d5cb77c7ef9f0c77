"""Loading values once, beside threads that must not wait for them."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from app.loading import Loading, NotLoaded, without_loading


@pytest.fixture
def kept():
    return {}


@pytest.fixture
def loading(kept):
    return Loading(kept.get)


def test_of_threads_that_need_the_same_value_one_loads_it(kept, loading):
    begun, go_on, loads = threading.Event(), threading.Event(), []

    def load():
        loads.append(1)
        begun.set()
        assert go_on.wait(60)
        kept["a"] = "loaded"
        return "loaded"

    with ThreadPoolExecutor(3) as pool:
        found = [pool.submit(loading.get, "a", load) for _ in range(3)]
        assert begun.wait(60)
        assert loading.get("b", lambda: "another") == "another"  # waits for nobody
        go_on.set()
        assert [one.result() for one in found] == ["loaded"] * 3
    assert len(loads) == 1
    assert loading.get("a", load) == "loaded"
    assert len(loads) == 1


def test_a_value_that_could_not_be_loaded_leaves_nothing_behind(kept, loading):
    def fail():
        raise OSError("damaged")

    for _ in range(2):
        with pytest.raises(OSError, match="damaged"):
            loading.get("a", fail)
    assert not loading._locks
    assert loading.get("a", lambda: "repaired") == "repaired"


def test_work_that_must_not_load_is_stopped_at_what_is_missing_and_passes_once_it_is_there(
    kept, loading
):
    def load():
        kept["a"] = 1
        return 1

    def work():
        return loading.get("a", load)

    stopped, again = without_loading(work), without_loading(work)
    assert isinstance(stopped, NotLoaded)
    assert isinstance(again, NotLoaded)
    assert not kept
    assert again.name == stopped.name
    assert stopped.load() == 1  # this thread may load again
    assert without_loading(work) == 1
