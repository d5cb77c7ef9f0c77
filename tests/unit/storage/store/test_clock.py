"""Clocks that jump: they are not trusted for a day of a running service."""

import errno
import logging
import os
from pathlib import Path

import pytest

from storage.errors import StorageFull
from storage.store.clock import ClockWatch

HOUR_S = 3600.0
DAY_S = 24 * HOUR_S
TODAY_S = 20_000 * DAY_S


class Machine:
    """A machine whose services watch the clock, each for a time."""

    def __init__(self, path):
        self.path = path
        self.clock_s = TODAY_S
        self.ticks_s = 0.0
        self.start()

    def start(self):
        self.watch = ClockWatch(
            self.path, wall=lambda: self.clock_s, monotonic=lambda: self.ticks_s
        )

    def trusts(self):
        return self.watch.is_trusted()

    def pass_hours(self, hours):
        """Let the service run; return whether the clock was trusted in each hour."""
        trusted = set()
        for _ in range(hours):
            self.clock_s += HOUR_S
            self.ticks_s += HOUR_S
            trusted.add(self.trusts())
        return trusted


@pytest.fixture
def machine(tmp_path):
    return Machine(tmp_path / "clock.json")


def test_a_steady_clock_is_trusted_at_once_and_after_a_restart(machine, caplog):
    assert machine.trusts()
    assert machine.pass_hours(50) == {True}
    machine.clock_s += 20 * HOUR_S  # stopped
    machine.start()
    assert machine.trusts()
    assert caplog.text == ""


@pytest.mark.parametrize("jump_s", [400 * DAY_S, -400 * DAY_S, -TODAY_S])
@pytest.mark.parametrize("restarted", [True, False])
def test_after_a_jump_the_clock_is_trusted_when_the_service_has_run_for_a_day(
    machine, jump_s, restarted, caplog
):
    machine.trusts()
    machine.clock_s += jump_s
    if restarted:
        machine.start()
    with caplog.at_level(logging.WARNING, "tensormap.storage"):
        assert not machine.trusts()
    assert "was expected at 2024-10-04 00:00Z: until the service has run" in caplog.text
    assert "nothing is removed for its age" in caplog.text
    assert machine.pass_hours(23) == {False}
    assert machine.pass_hours(2) == {True}


def test_a_clock_that_is_set_right_again_is_waited_for_too(machine):
    machine.clock_s = 0.0  # a first start in 1970
    assert machine.trusts()
    machine.clock_s = TODAY_S
    machine.start()
    assert not machine.trusts()


def test_after_a_restore_the_clock_is_trusted_when_services_have_run_for_a_day(machine):
    ClockWatch(machine.path, wall=lambda: machine.clock_s).distrust()
    machine.clock_s += 9 * DAY_S  # until the first start
    assert not machine.trusts()
    assert machine.pass_hours(20) == {False}
    machine.clock_s += 2 * DAY_S  # stopped
    machine.start()
    assert not machine.trusts()
    assert machine.pass_hours(5) == {False, True}


def test_a_wait_that_cannot_be_written_after_a_restore_is_an_error(machine, monkeypatch):
    def fill(*_arguments, **_options):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_text", fill)
    with pytest.raises(StorageFull):
        machine.watch.distrust()


def test_the_day_goes_on_after_restarts(machine):
    machine.trusts()
    machine.clock_s += 400 * DAY_S
    for _ in range(3):
        machine.start()
        assert not machine.trusts()
        assert machine.pass_hours(7) == {False}
        machine.clock_s += 5 * HOUR_S  # stopped, which does not count
    machine.start()
    assert machine.pass_hours(3) == {False}
    assert machine.pass_hours(2) == {True}


def test_a_machine_that_runs_for_some_hours_a_week_trusts_its_clock_after_a_day_in_total(machine):
    machine.trusts()
    weeks = []
    for _ in range(10):
        machine.clock_s += 6 * DAY_S  # off, for longer than a day
        machine.start()
        weeks.append({machine.trusts()} | machine.pass_hours(5))
    a_wait = [{False}] * 4 + [{False, True}]
    assert weeks == a_wait * 2


def test_what_is_left_of_a_wait_is_logged(machine, caplog):
    machine.trusts()
    for left in ("24.0", "17.0"):
        machine.clock_s += 6 * DAY_S
        machine.start()
        machine.trusts()
        assert f"until the service has run for {left} hours" in caplog.text
        machine.pass_hours(7)


def jump_back_during_a_stop(machine):
    machine.clock_s = 0.0
    machine.start()


def jump_back_while_it_runs(machine):
    machine.clock_s = 0.0


def jump_ahead_while_it_runs(machine):
    machine.clock_s += 400 * DAY_S


@pytest.mark.parametrize(
    "jump", [jump_back_during_a_stop, jump_back_while_it_runs, jump_ahead_while_it_runs]
)
def test_the_day_starts_again_if_the_clock_was_set_and_did_not_go_on_during_a_stop(machine, jump):
    machine.trusts()
    machine.clock_s += 6 * DAY_S
    machine.start()
    machine.trusts()
    assert machine.pass_hours(20) == {False}
    jump(machine)
    assert not machine.trusts()
    assert machine.pass_hours(23) == {False}


@pytest.mark.parametrize("jump", [jump_back_during_a_stop, jump_back_while_it_runs])
def test_what_was_deleted_in_1970_is_not_removed_for_a_day_after_the_clock_was_set_right(
    machine, jump
):
    machine.trusts()
    jump(machine)
    machine.trusts()
    assert machine.pass_hours(23) == {False}
    machine.clock_s = TODAY_S + 2 * DAY_S
    machine.start()
    assert not machine.trusts()
    assert machine.pass_hours(23) == {False}


@pytest.mark.parametrize(
    "content",
    [
        *("", "[]", "{}", "[[0, 0]]", "\0" * 20, "[" * 100_000),
        *('{"at_s": "x", "waits_s": 0}', '{"at_s": [], "waits_s": 0}'),
        *('{"at_s": 1e300, "waits_s": 0}', '{"at_s": -1e300, "waits_s": 0}'),
        *('{"at_s": 1e400, "waits_s": 0}', '{"at_s": 1%s, "waits_s": 0}' % ("0" * 400)),
        *('{"at_s": NaN, "waits_s": 0}', '{"at_s": 1.7e9, "waits_s": NaN}'),
        *('{"at_s": 1.7e9, "waits_s": 1e300}', '{"at_s": 1.7e9, "waits_s": -1}'),
    ],
    ids=lambda content: content[:40],
)
def test_a_damaged_file_is_logged_once_and_made_again(machine, content, caplog):
    machine.path.write_text(content)
    assert machine.trusts()
    assert machine.pass_hours(2) == {True}
    assert caplog.text.count("cannot be read, it is made again") == 1
    machine.start()
    machine.start()
    machine.clock_s += 400 * DAY_S
    assert not machine.trusts()


def test_a_watch_that_cannot_write_its_file_watches_on(tmp_path):
    machine = Machine(tmp_path / "nowhere" / "clock.json")
    assert machine.trusts()
    machine.clock_s += 400 * DAY_S
    assert not machine.trusts()
    assert machine.pass_hours(25) == {False, True}
