"""A run of benchmarks: which are measured again, and what fails the run."""

import pytest

from benchmarks import __main__ as program
from benchmarks.machine import Machine
from benchmarks.results import Committed, Row, table

THIS_ONE = Machine("this one", 20.0)
HOLDS, MISSED = Row("walk, s", 4.0, 8.0), Row("walk, s", 9.0, 8.0)
WORSE = Row("walk, s", 6.0, 8.0)
"""Holds its bar, and takes half as much again of it as the committed one."""


@pytest.fixture
def runs(monkeypatch):
    """What each run of the benchmark measures; those that remain were not asked for."""
    to_come: list[list[Row]] = []
    lines = {"legs": [HOLDS.line("legs")]}
    before = Committed.of_text(table(lines, THIS_ONE))
    monkeypatch.setattr(program, "_alone", lambda name: to_come.pop(0))
    monkeypatch.setattr(program, "committed", lambda: before)
    monkeypatch.setattr(program, "this_machine", lambda: THIS_ONE)
    return to_come


def check(runs, *measured):
    runs[:] = [[row] for row in measured]
    return program.main(["legs"], check=True)


def test_a_benchmark_that_holds_is_measured_once(runs):
    assert check(runs, HOLDS, MISSED) == 0
    assert runs == [[MISSED]]


@pytest.mark.parametrize("first", [MISSED, WORSE])
def test_a_benchmark_that_fails_is_measured_again_and_then_holds(runs, first):
    assert check(runs, first, HOLDS, MISSED) == 0
    assert runs == [[MISSED]]


def test_what_fails_three_times_fails_the_run(runs):
    assert check(runs, MISSED, MISSED, MISSED, HOLDS) == 2  # missed, and worse than committed
    assert check(runs, WORSE, WORSE, WORSE, HOLDS) == 1
    assert runs == [[HOLDS]]


def test_each_row_counts_as_it_was_at_its_best(runs):
    run, jump = (Row(name, 4.0, 8.0) for name in ("run, s", "jump, s"))
    no_run, no_jump = (Row(name, 9.0, 8.0) for name in ("run, s", "jump, s"))
    runs[:] = [[run, no_jump], [no_run, jump], [no_run, no_jump]]
    assert program.main(["legs"], check=True) == 0
    assert runs == [[no_run, no_jump]]


def test_the_table_is_written_of_rows_at_their_best_and_not_of_a_check(runs, monkeypatch):
    written = []
    monkeypatch.setattr(program, "renew", lambda rows, machine, commit: written.append(dict(rows)))
    runs[:] = [[MISSED], [HOLDS]]
    assert program.main(["legs"], check=False) == 0
    assert written == [{"legs": [HOLDS]}]
    assert check(runs, HOLDS) == 0
    assert len(written) == 1


def test_a_bar_that_was_missed_before_is_not_measured_again_and_still_fails(runs, monkeypatch):
    lines = {"legs": [MISSED.line("legs")]}
    monkeypatch.setattr(program, "committed", lambda: Committed.of_text(table(lines, THIS_ONE)))
    assert check(runs, MISSED, HOLDS) == 1
    assert runs == [[HOLDS]]
    assert runs == [[HOLDS]]
