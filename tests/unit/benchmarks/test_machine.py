"""Machines whose times can be compared."""

import pytest

from benchmarks.machine import Machine, this_machine

COMMITTED = Machine("CPU, Python 3.11.7", 20.0)


def test_the_machine_is_named_without_its_host_or_a_path():
    here = this_machine()
    assert "Python" in here.name
    assert "/" not in str(here)
    assert here.yardstick_ms is not None
    assert here.yardstick_ms > 0.0


@pytest.mark.parametrize("machine", [COMMITTED, Machine("CPU, Python 3.11.7")])
def test_a_machine_is_read_as_it_was_written(machine):
    assert Machine.of_text(str(machine)) == machine


@pytest.mark.parametrize(
    ("machine", "is_as"),
    [
        (COMMITTED, True),
        (Machine(COMMITTED.name, 23.9), True),
        (Machine(COMMITTED.name, 16.7), True),
        (Machine(COMMITTED.name, 24.1), False),
        (Machine(COMMITTED.name, 16.6), False),
        (Machine(COMMITTED.name), False),
        (Machine("another CPU", 20.0), False),
    ],
)
def test_times_are_compared_between_machines_of_one_name_and_speed(machine, is_as):
    assert machine.is_as(COMMITTED) == is_as
    assert COMMITTED.is_as(machine) == is_as
