"""Values that one thread computes while others wait."""

import gc
import threading
import weakref

import pytest

from core.single_flight import SingleFlight, single_flight_property, weakly


def test_one_thread_computes_a_value_that_several_need():
    computed, begun, go_on = [], threading.Event(), threading.Event()

    def compute(x):
        computed.append(x)
        begun.set()
        assert go_on.wait(10)
        return [x]

    values = SingleFlight(compute, kept=2)
    found = []
    threads = [threading.Thread(target=lambda: found.append(values(1))) for _ in range(4)]
    for thread in threads:
        thread.start()
    assert begun.wait(10)
    go_on.set()
    for thread in threads:
        thread.join()
    assert computed == [1]
    assert all(one is found[0] for one in found)


def test_another_value_is_computed_meanwhile():
    both = threading.Barrier(2, timeout=10)
    values = SingleFlight(lambda x: both.wait() + x, kept=2)
    thread = threading.Thread(target=values, args=(1,))
    thread.start()
    values(2)
    thread.join()


def test_the_values_of_the_last_arguments_are_kept():
    computed: list[int] = []
    values = SingleFlight(computed.append, kept=2)
    for x in (1, 2, 1, 3, 1, 2):
        values(x)
    assert computed == [1, 2, 3, 2]


def test_a_value_is_known_once_it_was_computed():
    values = SingleFlight(lambda x: x * x, kept=2)
    assert values.known(3) is None
    values(3)
    assert values.known(3) == 9


def test_a_value_that_could_not_be_computed_is_computed_again():
    left = [2.0, 0.0]
    values = SingleFlight(lambda: 1.0 / left.pop(), kept=1)
    with pytest.raises(ZeroDivisionError):
        values()
    assert values() == 0.5


class Squares:
    """Keeps values of a method of its own."""

    def __init__(self) -> None:
        self.of = SingleFlight(weakly(self._square), kept=2)

    def _square(self, x: int) -> int:
        return x * x


def test_an_object_that_keeps_values_of_its_own_method_leaves_the_memory_at_once():
    squares = Squares()
    assert (squares.of(3), squares.of(3), squares.of.known(3)) == (9, 9, 9)
    reference = weakref.ref(squares)
    gc.disable()
    try:
        del squares
        assert reference() is None
    finally:
        gc.enable()


class Computing:
    """Its value is computed when `go_on` is set."""

    def __init__(self) -> None:
        self.computed = 0
        self.fails = False
        self.begun, self.go_on = threading.Event(), threading.Event()

    @single_flight_property
    def value(self) -> list[int]:
        """A value."""
        self.computed += 1
        self.begun.set()
        assert self.go_on.wait(10)
        if self.fails:
            raise ValueError("no value")
        return [self.computed]


def test_one_thread_computes_a_property_that_several_need():
    one = Computing()
    found: list[list[int]] = []
    threads = [threading.Thread(target=lambda: found.append(one.value)) for _ in range(4)]
    for thread in threads:
        thread.start()
    assert one.begun.wait(10)
    one.go_on.set()
    for thread in threads:
        thread.join()
    assert one.computed == 1
    assert found == [[1]] * 4
    assert one.value is found[0]


def test_a_property_of_another_object_is_computed_meanwhile():
    one, other = Computing(), Computing()
    thread = threading.Thread(target=lambda: one.value)
    thread.start()
    assert one.begun.wait(10)
    other.go_on.set()
    assert other.value == [1]
    one.go_on.set()
    thread.join()


def test_a_property_that_could_not_be_computed_is_computed_again():
    one = Computing()
    one.go_on.set()
    one.fails = True
    with pytest.raises(ValueError, match="no value"):
        _ = one.value
    one.fails = False
    assert one.value == [2]
    assert isinstance(Computing.value, single_flight_property)
