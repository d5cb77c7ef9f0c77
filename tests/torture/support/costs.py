"""What something costs this process and those that it starts: CPU seconds, megabytes of memory."""

import os
import resource
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

_LOOK_S = 0.01


def cost_of(act: Callable[[], str]) -> dict[str, Any]:
    """Return `cpu_s`, `mb` that were added at the peak, and what the act returned, `outcome`."""
    idle_kb = _status("VmRSS")
    forget_peak()
    start_s = _cpu_s()
    with _children_watched() as peaks_kb:
        outcome = act()
    cpu_s = _cpu_s() - start_s
    child_kb = max(peaks_kb.values(), default=0)
    # What the interpreter and its libraries take is there already: a body costs what it adds.
    added_kb = max(peak_kb() - idle_kb, 0) + child_kb
    return {"cpu_s": round(cpu_s, 3), "mb": round(added_kb / 1024), "outcome": outcome}


def forget_peak() -> None:
    """Let the peak be from now on; of a program that was just begun it is that of its parent."""
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def peak_kb() -> int:
    """Return the most memory that this process held since `forget_peak`."""
    return _status("VmHWM")


def _cpu_s() -> float:
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


@contextmanager
def _children_watched() -> Iterator[dict[int, int]]:
    """Yield the peak of each child while the block runs, in KiB, as last seen.

    `RUSAGE_CHILDREN` has that of this process too, which a child is until it runs its program.
    """
    peaks_kb: dict[int, int] = {}
    done = threading.Event()

    def look() -> None:
        while not done.wait(_LOOK_S):
            for pid in children_of(os.getpid()):
                with suppress(FileNotFoundError, ProcessLookupError, StopIteration):
                    peaks_kb[pid] = _status("VmHWM", pid)  # a zombie has none

    looking = threading.Thread(target=look)
    looking.start()
    try:
        yield peaks_kb
    finally:
        done.set()
        looking.join()


def children_of(pid: int) -> list[int]:
    """Return the processes that a process has started and that are there."""
    found = []
    with suppress(FileNotFoundError, ProcessLookupError):
        for task in Path(f"/proc/{pid}/task").iterdir():
            with suppress(FileNotFoundError, ProcessLookupError):
                found += [int(child) for child in (task / "children").read_text().split()]
    return found


def _status(key: str, pid: int | str = "self") -> int:
    lines = Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(key))
