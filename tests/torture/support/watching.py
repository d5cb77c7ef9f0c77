"""What a service's processes use, and for how long the service does not answer."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import httpx2

from tests.torture.support.service import Tortured

_EVERY_S = 0.05
_PAGE_BYTES = 4096


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
