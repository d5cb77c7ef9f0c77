"""Two functions timed in turn, so that a machine that drifts drifts for both; of CPU time."""

import platform
import statistics
import time
from collections.abc import Callable

import numpy as np

_FREED_BYTES = 31 * 2**20  # just below the most that glibc adapts to


def medians_s(
    ours: Callable[[], object], other: Callable[[], object], runs: int
) -> tuple[float, float]:
    """Return the median CPU seconds of both, after one run each that is not counted."""
    # What a process freed before decides whether glibc returns each large array to the kernel and
    # gets it again page by page, which made the same function take 2.2 or 3.5 ms.
    np.ones(_FREED_BYTES, np.uint8)
    times: tuple[list[float], list[float]] = ([], [])
    for run in range(runs + 1):
        for function, of_it in zip((ours, other), times, strict=True):
            begun = time.process_time()
            function()
            if run:
                of_it.append(time.process_time() - begun)
    return statistics.median(times[0]), statistics.median(times[1])


def machine() -> str:
    """Name the processor and the interpreter."""
    return f"{platform.processor() or platform.machine()}, Python {platform.python_version()}"
