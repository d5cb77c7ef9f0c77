"""What a service's processes use, and for how long the service does not answer."""

import os
import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import httpx2
import numpy as np

from tests.torture.support.service import Tortured

_EVERY_S = 0.05
_LOOKED_S = 1.0  # between two looks of a meter
_GROWN_BYTES = 30 * 2**20  # of a process, over the measured part of ten minutes
_MORE_THREADS, _MORE_DESCRIPTORS = 4, 16


@dataclass(frozen=True)
class Used:
    """What one process uses.

    Attributes:
        memory_bytes: Resident, and not of a file.
        threads: Its threads.
        descriptors: Its open files and connections.
    """

    memory_bytes: int
    threads: int
    descriptors: int


def used_by(pid: int) -> Used | None:
    """Return what a process uses, `None` if it has ended."""
    process = Path(f"/proc/{pid}")
    try:
        status = dict(line.split(":", 1) for line in (process / "status").read_text().splitlines())
        if "RssAnon" not in status:  # it waits to be reaped
            return None
        return Used(
            memory_bytes=int(status["RssAnon"].split()[0]) * 1024,
            threads=int(status["Threads"]),
            descriptors=sum(1 for _ in (process / "fd").iterdir()),
        )
    except (FileNotFoundError, ProcessLookupError):
        return None


def cpu_s(pid: int) -> float:
    """Return the CPU seconds of a process and of its threads, so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@dataclass
class Watch:
    """What was seen of a service while a block ran.

    Attributes:
        grown_bytes: The most that the serving process grew by.
        longest_s: The longest that `/livez` took, on a connection kept open.
        requests: How often it was requested.
        faults: What was no answer.
    """

    grown_bytes: int = 0
    longest_s: float = 0.0
    requests: int = 0
    faults: list[str] = field(default_factory=list)

    def require(self, *, longest_s: float = 1.0, grown_bytes: int = 200 * 2**20) -> None:
        """Require that it answered in time, every time, and did not grow by more than that."""
        assert not self.faults, self.faults[:3]
        assert self.requests, "/livez was never requested"
        assert self.longest_s < longest_s, f"/livez took {self.longest_s:.2f} s"
        assert self.grown_bytes < grown_bytes, f"it grew by {self.grown_bytes / 2**20:.0f} MB"


@contextmanager
def watching(service: Tortured, *, every_s: float = _EVERY_S) -> Iterator[Watch]:
    """Request `/livez`, and look at the memory of the process that serves, until the block ends."""
    watch = Watch()
    done = threading.Event()
    before = used_by(service.pid)
    assert before is not None

    def look() -> None:
        with service.client(None, timeout=30) as client:
            while not done.wait(every_s):
                began = time.monotonic()
                try:
                    status = client.get("/livez").status_code
                    if status != 200:
                        watch.faults.append(f"/livez: {status}")
                except httpx2.TransportError as error:
                    watch.faults.append(f"/livez: {error!r}")
                watch.longest_s = max(watch.longest_s, time.monotonic() - began)
                watch.requests += 1
                now = used_by(service.pid)
                if now is not None:
                    grown = now.memory_bytes - before.memory_bytes
                    watch.grown_bytes = max(watch.grown_bytes, grown)

    looking = threading.Thread(target=look, name="watch")
    looking.start()
    try:
        yield watch
    finally:
        done.set()
        looking.join()


class Meter:
    """What every lasting process of a service used, time after time.

    Attributes:
        measured: The processes of which `faults` was able to say whether they grew.
    """

    def __init__(self, service: Tortured) -> None:
        self._service = service
        self.measured: set[int] = set()
        self._seen: defaultdict[int, list[tuple[float, Used]]] = defaultdict(list)

    def look(self) -> None:
        """Note what each process uses now."""
        for pid in self._service.processes():
            used = used_by(pid)
            if used is not None:
                self._seen[pid].append((time.monotonic(), used))

    def faults(self, since: float) -> list[str]:
        """Return what grew in processes that were there from then to the end."""
        wrong = []
        last = max(at for seen in self._seen.values() for at, _ in seen)
        for pid, seen in self._seen.items():
            late = [(at, used) for at, used in seen if at >= since]
            if len(late) < 5 or seen[0][0] > since or seen[-1][0] < last - 2 * _LOOKED_S:
                continue  # a build's, which ends with it
            self.measured.add(pid)
            grown = self._grown_bytes(late)
            print(f"process {pid}: {grown / 2**20:+.1f} MB, {late[-1][1]}")
            if grown > _GROWN_BYTES:
                wrong.append(f"process {pid} grew by {grown / 2**20:.0f} MB")
            first = max((used for _, used in late[: len(late) // 3]), key=lambda u: u.threads)
            if late[-1][1].threads > first.threads + _MORE_THREADS:
                wrong.append(f"process {pid}: {first.threads}, then {late[-1][1].threads} threads")
            most = max(used.descriptors for _, used in late[: len(late) // 3])
            if late[-1][1].descriptors > most + _MORE_DESCRIPTORS:
                wrong.append(f"process {pid}: {most}, then {late[-1][1].descriptors} descriptors")
        return wrong

    @staticmethod
    def _grown_bytes(late: list[tuple[float, Used]]) -> float:
        """Return the slope of memory over time, times that time."""
        times = np.array([at for at, _ in late])
        memory = np.array([float(used.memory_bytes) for _, used in late])
        slope = float(np.polyfit(times - times[0], memory, 1)[0])
        return slope * float(times[-1] - times[0])
