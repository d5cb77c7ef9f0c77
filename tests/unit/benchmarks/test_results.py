"""Rows against bars, and against the committed table."""

import subprocess

import pytest

from benchmarks import results
from benchmarks.machine import Machine
from benchmarks.results import Committed, Row, committed, renew, show, table

SLOW, FAST = (
    Row("walk, s", 4.0, 8.0, "floor 1.00"),
    Row("runs a second", 200.0, 300.0, at_least=True),
)
HERE = Row("ready, s", 1.0, 2.0, of_machine=True)
THIS_ONE, ANOTHER = Machine("this one", 20.0), Machine("another", 20.0)
ROWS = {"legs": [SLOW, FAST], "start": [HERE]}


LINES = {name: [row.line(name, "abc123") for row in rows] for name, rows in ROWS.items()}


def before(machine: Machine = THIS_ONE) -> Committed:
    return Committed.of_text(table(LINES, machine))


def test_a_ratio_is_the_share_of_the_bar_that_is_taken():
    assert SLOW.ratio == 0.5
    assert FAST.ratio == 1.5
    assert [row.holds for row in (SLOW, FAST)] == [True, False]


def test_the_table_is_read_as_it_was_written():
    read = before()
    assert read.machine == THIS_ONE
    assert read.ratios == {
        ("legs", "walk, s"): 0.5,
        ("legs", "runs a second"): 1.5,
        ("start", "ready, s"): 0.5,
    }
    assert read.of_machine == {("start", "ready, s")}


def test_the_table_shows_bars_beside_what_they_were_made_of():
    lines = table(LINES, THIS_ONE).splitlines()
    assert "| legs | walk, s | 4 | <= 8 | 0.50 | yes | floor 1.00 | abc123 |" in lines
    assert "| legs | runs a second | 200 | >= 300 | 1.50 | **no** |  | abc123 |" in lines


@pytest.mark.parametrize(("measured", "is_worse"), [(1.0, False), (5.1, False), (5.3, True)])
def test_a_ratio_may_grow_by_less_than_a_third(measured, is_worse):
    worse = before().worse("legs", [Row("walk, s", measured, 8.0)], THIS_ONE)
    assert bool(worse) == is_worse
    assert all("0.66 of its bar, committed 0.50" in line for line in worse)


@pytest.mark.parametrize(("measured", "is_worse"), [(6.3, False), (6.5, True)])
def test_on_another_machine_it_may_grow_by_more(measured, is_worse):
    worse = before().worse("legs", [Row("walk, s", measured, 8.0)], ANOTHER)
    assert bool(worse) == is_worse


def test_small_ratios_are_compared_by_all_digits_of_their_rows():
    lines = {"legs": [Row("rest, ms", 4.49, 100.0).line("legs")]}  # shown as .04
    committed_before = Committed.of_text(table(lines, THIS_ONE))
    assert committed_before.worse("legs", [Row("rest, ms", 5.8, 100.0)], THIS_ONE) == []
    assert committed_before.worse("legs", [Row("rest, ms", 5.9, 100.0)], THIS_ONE)


def test_a_row_that_is_new_or_of_another_benchmark_is_not_compared():
    rows = [Row("jump, s", 100.0, 1.0)]
    assert before().worse("legs", rows, THIS_ONE) == []
    assert before().worse("start", [Row("walk, s", 100.0, 1.0)], THIS_ONE) == []


def test_a_time_is_compared_on_the_same_machine_only():
    rows = [Row("ready, s", 2.0, 2.0, of_machine=True)]
    assert len(before().worse("start", rows, THIS_ONE)) == 1
    assert before().worse("start", rows, ANOTHER) == []


def test_without_an_earlier_table_nothing_is_worse():
    assert Committed.of_text("").worse("legs", ROWS["legs"], THIS_ONE) == []


def test_as_many_bars_are_missed_as_do_not_hold(capsys):
    assert show([SLOW, FAST], "legs") == 1
    assert "**no**" in capsys.readouterr().out


def test_the_committed_table_is_that_of_the_commit_not_of_the_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(results, "RESULTS", tmp_path / "RESULTS.md")
    assert committed().ratios == {}
    results.RESULTS.write_text(table(LINES, THIS_ONE))
    identity = ("-c", "user.name=a", "-c", "user.email=a@b.c")
    for words in (["init", "-q"], ["add", "."], [*identity, "commit", "-qm", "results"]):
        subprocess.run(["git", "-C", str(tmp_path), *words], check=True)
    results.RESULTS.write_text("")
    assert committed().ratios[("legs", "walk, s")] == 0.5


def test_rows_of_one_benchmark_are_renewed_and_others_stay(tmp_path, monkeypatch):
    monkeypatch.setattr(results, "RESULTS", tmp_path / "RESULTS.md")
    renew(ROWS, THIS_ONE, "c0ffee")
    renew({"start": [Row("ready, s", 1.5, 2.0, of_machine=True)]}, THIS_ONE, "c0ffee")
    ratios = Committed.of_text(results.RESULTS.read_text()).ratios
    assert ratios[("legs", "walk, s")] == 0.5
    assert ratios[("start", "ready, s")] == 0.75


def test_on_another_machine_or_at_another_speed_only_rows_measured_beside_others_stay(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(results, "RESULTS", tmp_path / "RESULTS.md")
    renew(ROWS, THIS_ONE, "c0ffee")
    renew({"jump": [HERE]}, Machine(THIS_ONE.name, 25.0), "c0ffee")
    after = Committed.of_text(results.RESULTS.read_text())
    assert list(after.lines) == ["legs", "jump"]
    assert after.machine == Machine(THIS_ONE.name, 25.0)


def test_small_differences_of_speed_do_not_add_up(tmp_path, monkeypatch):
    monkeypatch.setattr(results, "RESULTS", tmp_path / "RESULTS.md")
    for yardstick_ms in (20.0, 23.5, 22.0):
        renew(ROWS, Machine(THIS_ONE.name, yardstick_ms), "c0ffee")
    assert Committed.of_text(results.RESULTS.read_text()).machine == THIS_ONE
