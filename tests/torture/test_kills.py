"""The service is killed at any moment while four clients write: all that it acknowledged is there.

"201 means that it is on disk": scans, poses, revisions, what is live, keys and queued builds are
read back after each start, bit for bit.
"""

import os
import random
import signal
import threading
import time
from pathlib import Path

import pytest

from tests.support.process import is_running
from tests.torture.support.ledger import Ledger, require_acknowledged
from tests.torture.support.service import Tortured, tortured
from tests.torture.support.sizes import OWN_TREE, TREE, chance, size
from tests.torture.support.writers import Writer
from tests.torture.support.writes import ended_job

_KILLS = size("kills", 12)
_WRITERS = 4
_LONGEST_S = 1.5  # of writing between a start and a kill
_VERIFY_EVERY = 6
_READ_AGAIN = 40  # of what was there before the last kill


@pytest.fixture
def service(tmp_path):
    with tortured(tmp_path) as running:
        yield running


class Campaign:
    """Kills in a row, each after some writing and before a check of all that was promised."""

    def __init__(self, service: Tortured) -> None:
        self.service = service
        self.ledger = Ledger()
        self.writers = [
            Writer(number, self.ledger, chance("writer", number)) for number in range(_WRITERS)
        ]
        self.may_fail: set[str] = set()
        self._checked: set[tuple[str, ...]] = set()

    def write_and_kill(self, moment: random.Random) -> str:
        """Let all write until the service is killed; return how that was."""
        how = moment.choices(["service", "build", "stopping", "starting"], [6, 2, 1, 2])[0]
        stop, ending = threading.Event(), threading.Event()
        threads = [
            threading.Thread(target=writer.write_until, args=(self.service, stop, ending))
            for writer in self.writers
        ]
        for thread in threads:
            thread.start()
        time.sleep(moment.uniform(0.05, _LONGEST_S))
        if how == "build":
            self._kill_a_build(moment)
            time.sleep(moment.uniform(0.0, 0.3))
        crashed = None if self.service.is_alive else self.service.crash_report()
        ending.set()
        if how == "stopping" and crashed is None:
            os.kill(self.service.pid, signal.SIGTERM)
            time.sleep(moment.uniform(0.0, 0.3))
        self.service.kill()
        stop.set()
        for thread in threads:
            thread.join()
        assert crashed is None, f"the service ended before it was killed: {crashed}"
        if how == "starting":
            for _ in range(2):
                self.service.start(ready=False)
                time.sleep(moment.uniform(0.0, 2.0))
                self.service.kill()
        return how

    def _kill_a_build(self, moment: random.Random) -> None:
        """Kill a process that the service started; what it was building may fail by name."""
        others = self.service.processes()[1:]
        if others:
            self.may_fail.update(job for writer in self.writers for job in writer.jobs)
            victim = moment.choice(others)
            if is_running(victim):
                os.kill(victim, signal.SIGKILL)

    def require_all(self, *, again: random.Random | None) -> None:
        """Require what was acknowledged since the last time, and some or all of what was before."""
        wrong = [fault for writer in self.writers for fault in writer.faults]
        assert not wrong, wrong
        things = self.ledger.things()
        unsettled = set(self.ledger.things(unsettled=True))
        if again is not None:
            old = [t for t in things if t in self._checked and t not in unsettled]
            new = [t for t in things if t not in self._checked or t in unsettled]
            things = new + again.sample(old, min(_READ_AGAIN, len(old)))
        with self.service.client() as client:
            require_acknowledged(self.service, client, self.ledger, things)
        self._checked.update(things)

    def require_builds(self) -> None:
        """Require every build that was promised to end, and well unless it was killed.

        It may fail if its own process was killed, or five times the service while it ran.
        """
        with self.service.client() as client:
            for writer in self.writers:
                for job in writer.jobs:
                    ended = ended_job(client, job, within_s=120)
                    if ended["state"] != "done":
                        assert ended["error"]["type"] == "/problems/worker-died", ended
                        crashed = "the service ended without a stop" in ended["error"]["detail"]
                        assert crashed or job in self.may_fail, ended
                    else:
                        thing = ("revision", writer.built, ended["revision"])
                        self.ledger.note(thing, ended["revision"])


def require_verified(service: Tortured) -> None:
    """Require `tensormap verify` to find nothing, where the release has it."""
    if TREE == OWN_TREE or service.has("verify"):
        ended = service.command("verify", "--data", service.data_dir)
        assert ended.returncode == 0, ended.stdout + ended.stderr
    else:
        print("this release has no `tensormap verify`")


def test_what_was_acknowledged_is_there_after_every_kill(service):
    campaign = Campaign(service)
    with service.client() as client:
        for writer in campaign.writers:
            writer.make(client)
    kinds: list[str] = []
    for number in range(_KILLS):
        moment = chance("kill", number)
        kinds.append(campaign.write_and_kill(moment))
        service.start()
        campaign.require_all(again=moment)
        if number % _VERIFY_EVERY == _VERIFY_EVERY - 1:
            require_verified(service)
    campaign.require_builds()
    campaign.require_all(again=None)
    require_verified(service)
    ledger = campaign.ledger
    counts = {kind: kinds.count(kind) for kind in sorted(set(kinds))}
    print(f"{_KILLS} kills {counts}: {ledger.acknowledged} acknowledged, {ledger.unanswered} not")
    assert ledger.acknowledged > _KILLS
    assert_nothing_left_half_written(service.data_dir)


def assert_nothing_left_half_written(data_dir: Path) -> None:
    left = [path for path in data_dir.rglob("*") if path.name.endswith(".part")]
    assert not left, left
