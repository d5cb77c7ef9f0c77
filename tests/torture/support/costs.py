"""What something costs this process and those that it starts: CPU seconds, megabytes of memory."""

import resource
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any


def cost_of(act: Callable[[], str]) -> dict[str, Any]:
    """Return `cpu_s`, `mb` that were added at the peak, and what the act returned, `outcome`."""
    idle_kb, forked_kb = _status("VmRSS"), _forked_kb()
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # the peak is from now on
    start_s = _cpu_s()
    outcome = act()
    cpu_s = _cpu_s() - start_s
    child_kb = _forked_kb() if _forked_kb() > forked_kb else 0
    # What the interpreter and its libraries take is there already: a body costs what it adds.
    added_kb = max(_status("VmHWM") - idle_kb, 0) + child_kb
    return {"cpu_s": round(cpu_s, 3), "mb": round(added_kb / 1024), "outcome": outcome}


def _cpu_s() -> float:
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def _forked_kb() -> int:
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss


def _status(key: str) -> int:
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(key))
