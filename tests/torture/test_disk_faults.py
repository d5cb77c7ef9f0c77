"""Every write, sync and rename of every kind of write fails once, and from then on.

The service continues to answer. What it acknowledged under the fault is read back bit for bit, what
it refused has a name and succeeds when requested again; what was stored before is unchanged.
"""

import hashlib
import re
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import httpx2
import pytest

from core.errors import TensorMapError
from tests.support.recording import NPY
from tests.torture.support.bodies import HDF5, map_file, noise
from tests.torture.support.faults import FAULTS, Fault, Faults
from tests.torture.support.service import Tortured, tortured
from tests.torture.support.sizes import chance, size
from tests.torture.support.writes import WRITES, Backup, Build, Import, PutScan, Write

_WHOLE = {PutScan, Import, Build}  # every call of these fails once; in a short run not all alike
_ALIKE = 8  # so many of those that do the same to the same file, as 94 writes of a build's log
_SAMPLE = size("faults", 2)  # calls of each write and kind of fault otherwise; 0 for every one
_INTERMITTENT = size("intermittent", 20)
_MOST = 2_000  # calls of one write
_UNSTEADY = 12  # calls that it may have more of the next time: a catalog's checkpoint, progress
_USED_EVERY = 5  # of the writes of a catalog's log that fail: another build
_SHOWN = 5
_SURE = 3  # of the first calls of a write, which are always made
_ENDING_S = 2.0
# What other threads write, at any time; and what a catalog does not need after a power failure.
_UNSYNCED = ("/tmp/", "/data/.clock.json", "/data/clock.json", "-shm", "-journal")
_CATALOG_LOG = "/data/catalog.sqlite3-wal"

_WRONG = (AssertionError, httpx2.HTTPError, TensorMapError)
_REFUSED = {"storage-full", "storage-read-only", "storage-unavailable", "storage-busy"}


class Attacked:
    """A service whose disk fails, and what it held before.

    Attributes:
        service: The service.
        faults: Its disk.
        client: An administrator.
        kept: Writes that it acknowledged and that are to be there whatever comes.
    """

    def __init__(self, service: Tortured, faults: Faults) -> None:
        self.service, self.faults = service, faults
        self.client = service.client()
        self.kept: list[Write] = []
        self._number = 0
        self.client.post("/v1/maps", json={"map": "before"}).raise_for_status()
        path = "/v1/maps/before/drives/monday/scans/0"
        self.client.put(path, content=noise("before"), headers=NPY).raise_for_status()
        path = "/v1/maps/before/revisions"
        self.client.post(path, content=map_file()[1], headers=HDF5).raise_for_status()
        self._before = self._stored_before()

    def new(self, kind: type[Write]) -> Write:
        """Prepare a write that is not requested yet."""
        self._number += 1
        write = kind(self.service, self.client, self._number)
        write.lift, write.variables = self.faults.lift, self.faults.environment
        write.prepare()
        return write

    def calls_of(self, kind: type[Write]) -> list[str]:
        """Return the calls of which a write consists."""
        write = self.new(kind)
        with self.faults.counting():
            assert write.attempt() is None
        count = sum(self.faults.counted.values())
        return [self.faults.called(number) for number in range(1, count + 1)]

    def struck(self, kind: type[Write], fault: Fault, first: int) -> str | None:
        """Let a write meet a fault; return what is wrong, `None` if all is well."""
        outcome: str | None = "?"
        try:
            write = self.new(kind)
        except httpx2.TransportError as wrong:
            return self.explained(kind, fault, 0, "of the fault before this one", wrong)
        try:
            with self.faults.failing(fault, first):
                outcome = write.attempt()
            of_catalog = "catalog.sqlite3" in self.faults.called(first)
            used = not of_catalog or self._number % _USED_EVERY == 0
            self.require_well(write, outcome, fault, used=used)
        except _WRONG as wrong:
            return self.explained(kind, fault, first, outcome, wrong)
        return None

    def require_well(
        self, write: Write, outcome: str | None, fault: Fault, *, used: bool = True
    ) -> None:
        assert self.service.is_alive
        with self.service.client(None) as client:
            assert client.get("/livez").status_code == 200
        if outcome is None:
            write.require_kept()
        else:
            assert outcome in _REFUSED, f"it was refused as {outcome!r}"
            assert not fault.halve, f"a short write was refused as {outcome!r}"
            again = write.attempt()
            assert again is None, f"without a fault it was refused as {again!r}"
            write.require_kept()
        if used:
            write.require_usable()
        assert self._stored_before() == self._before, "what was stored before has changed"
        if not isinstance(write, Backup):  # a file of its own, which no kill of a service loses
            self.kept.append(write)

    def explained(
        self, kind: type[Write], fault: Fault, first: int, outcome: str | None, wrong: Exception
    ) -> str:
        where = f"{kind.__name__}, {fault.name}, {self.faults.called(first)}"
        if isinstance(wrong, httpx2.TransportError):
            time.sleep(_ENDING_S)  # a crash takes a moment
        met = f"{self.faults.failed} calls failed, answer {outcome or 'success'}"
        ended = (
            "" if self.service.is_alive else f"; THE SERVICE ENDED: {self.service.crash_report()}"
        )
        if not self.service.is_alive:
            self.restart()
        first_line = str(wrong).strip().partition("\n")[0] or repr(wrong)
        return f"{where} ({met}): {re.sub('[0-9a-f]{32,}', '...', first_line)[:400]}{ended}"

    def restart(self) -> None:
        """Kill the service and start it again, on a disk without faults."""
        if self.service.is_alive:
            self.service.kill()
        self.service.start()
        self.client.close()
        self.client = self.service.client()
        for write in self.kept:
            write.client = self.client

    def require_kept(self) -> None:
        """Require all that was acknowledged to be there after a kill."""
        self.restart()
        assert self._stored_before() == self._before
        for write in self.kept:
            write.require_kept()

    def _stored_before(self) -> tuple[str, str, object]:
        scan = self.client.get("/v1/maps/before/drives/monday/scans/0").raise_for_status()
        file = self.client.get(f"/v1/maps/before/revisions/{map_file()[0]}/file").raise_for_status()
        live = self.client.get("/v1/maps/before").raise_for_status().json()["live_revision"]
        return (
            hashlib.sha256(scan.content).hexdigest(),
            hashlib.sha256(file.content).hexdigest(),
            live,
        )


@pytest.fixture
def attacked(faults_library: Path, tmp_path: Path) -> Iterator[Attacked]:
    with (
        Faults(faults_library, tmp_path, tmp_path / "disk") as faults,
        tortured(tmp_path, faults.environment) as service,
    ):
        attacked = Attacked(service, faults)
        yield attacked
        attacked.client.close()


def numbers(kind: type[Write], fault: Fault, calls: Sequence[str]) -> Iterator[int]:
    """Yield which calls of a write are to fail, from 1: each and some more, or a sample."""
    candidates = may_fail(fault, calls)
    chosen = chance("faults", kind.__name__, fault.name)
    if _SAMPLE == 0:
        yield from range(1, _MOST)
    elif kind in _WHOLE and fault is FAULTS[0]:
        alike: dict[str, list[int]] = {}
        for number, call in enumerate(calls, 1):
            alike.setdefault(call.partition(": ")[2], []).append(number)
        for group in alike.values():
            yield from sorted(chosen.sample(group, min(_ALIKE, len(group))))
        yield from range(len(calls) + 1, _MOST)
    else:
        yield from chosen.sample(candidates, min(_SAMPLE, len(candidates)))


def may_fail(fault: Fault, calls: Sequence[str]) -> list[int]:
    """Return which calls a fault can be met by: only a write can be a short one."""
    return [n for n, call in enumerate(calls, 1) if not fault.halve or ": write " in call]


def require_synced(calls: Sequence[str]) -> None:
    """Require what a write changed to be on disk when it is acknowledged, and in this order.

    A file is synced after it was written and before any in its folder gets its name, the folder
    after that. Other threads write the catalog's log too: of it some sync after a write counts.
    """
    done = [tuple(call.partition(": ")[2].split(" ", 1)) for call in calls]
    assert all(len(call) == 2 for call in done), "there were more calls than are noted"
    written: set[str] = set()  # and not synced since
    logged = False
    for operation, path in done:
        folder = path.rpartition("/")[0]
        if path == _CATALOG_LOG:
            logged |= operation == "write"
            if operation == "sync":
                written.discard(path)
        elif any(word in path for word in _UNSYNCED):
            continue
        elif operation in {"write", "truncate"}:
            written.add(path)
        elif operation == "sync":
            written.discard(path)
        elif operation in {"rename", "mkdir"}:
            early = [file for file in written if file.startswith(f"{folder}/")]
            assert operation == "mkdir" or not early, f"{path} is named before a sync of {early}"
            written.add(folder)
    assert not written, f"not synced: {written}"
    assert not logged or ("sync", _CATALOG_LOG) in done, "the catalog's log is not synced"


def shown(wrong: list[str], struck: int) -> str:
    """Return what is wrong, an example of each kind of it first."""
    examples: dict[str, str] = {}
    for problem in wrong:
        examples.setdefault(problem.partition("): ")[2][:60], problem)
    others = [problem for problem in wrong if problem not in examples.values()]
    lines = [*examples.values(), *others[:_SHOWN]]
    return f"{len(wrong)} of {struck} faults:\n" + "\n".join(lines)


@pytest.mark.parametrize("kind", WRITES, ids=lambda kind: kind.__name__)
def test_a_fault_of_the_disk_loses_nothing_that_was_acknowledged(attacked, kind):
    calls = attacked.calls_of(kind)
    require_synced(calls)
    wrong: list[str] = []
    struck = dict.fromkeys(FAULTS, 0)

    def strike(fault: Fault, number: int) -> bool:
        problem = attacked.struck(kind, fault, number)
        if problem is not None:
            wrong.append(problem)
        struck[fault] += bool(attacked.faults.failed)
        return bool(attacked.faults.failed)

    for fault in FAULTS:
        for number in numbers(kind, fault, calls):
            if not strike(fault, number) and number > len(calls) + _UNSTEADY:
                break  # the write has no more calls
        if not struck[fault]:  # those of the sample were of another thread, which was idle now
            any(strike(fault, number) for number in may_fail(fault, calls)[:_SURE])
    assert all(struck.values()), struck
    assert not wrong, shown(wrong, sum(struck.values()))
    attacked.require_kept()


def test_write_errors_now_and_then_do_not_end_the_service(attacked):
    wrong: list[str] = []
    failed = 0
    for number in range(_INTERMITTENT):
        chosen = chance("intermittent", number)
        kind = chosen.choice([Import, Build] * 4 + [k for k in WRITES if k is not Backup])
        fault, share = chosen.choice(FAULTS[:2]), chosen.choice([0.02, 0.1, 0.3])
        outcome: str | None = "?"
        try:
            write = attacked.new(kind)
            with attacked.faults.failing_often(fault, share, number):
                outcome = write.attempt()
            failed += attacked.faults.failed
            attacked.require_well(write, outcome, fault)
        except _WRONG as error:
            wrong.append(attacked.explained(kind, fault, 0, outcome, error))
    assert failed > _INTERMITTENT // 4, f"only {failed} calls failed"
    assert not wrong, shown(wrong, _INTERMITTENT)
    attacked.require_kept()
