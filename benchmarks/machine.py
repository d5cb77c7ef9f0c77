"""The machine that is measured on: what it is, and how fast it was at the time.

Virtual machines have one name of a processor at several speeds: times are compared between runs
only where a fixed task, the yardstick, took the same time.
"""

import re
import time
from dataclasses import dataclass

import numpy as np

from app.provenance import provenance

ALIKE = 1.2
"""By so much two times of the yardstick may differ on one machine."""
_RUNS = 20
_TEXT = re.compile(r"(?P<name>.*), yardstick (?P<yardstick_ms>[0-9.]+) ms")


@dataclass(frozen=True)
class Machine:
    """A machine.

    Attributes:
        name: Processor and versions.
        yardstick_ms: CPU time of the yardstick, `None` if it was not measured.
    """

    name: str
    yardstick_ms: float | None = None

    @classmethod
    def of_text(cls, text: str) -> "Machine":
        """Read what `str` wrote, a name alone too.

        Examples:
            >>> Machine.of_text("CPU, Python 3.11.7, yardstick 40.0 ms")
            Machine(name='CPU, Python 3.11.7', yardstick_ms=40.0)
        """
        found = _TEXT.fullmatch(text)
        return cls(text) if found is None else cls(found["name"], float(found["yardstick_ms"]))

    def __str__(self) -> str:
        """Name it, with its yardstick if that is known."""
        if self.yardstick_ms is None:
            return self.name
        return f"{self.name}, yardstick {self.yardstick_ms:.1f} ms"

    def is_as(self, other: "Machine") -> bool:
        """Return whether times of the other one can be compared with times of this one."""
        ours, theirs = self.yardstick_ms, other.yardstick_ms
        if self.name != other.name or ours is None or theirs is None:
            return False
        return max(ours, theirs) <= ALIKE * min(ours, theirs)


def this_machine() -> Machine:
    """Return processor and versions, without the name of the host or a path, and the yardstick."""
    of = provenance()
    name = f"{of['machine']}, Python {of['python']}, NumPy {of['numpy']}"
    return Machine(name, min(_yardstick_ms() for _ in range(_RUNS)))


def _yardstick_ms() -> float:
    """Return the CPU time of what an answer is made of: Python, small arrays and large ones."""
    begun = time.process_time()
    small, large = np.arange(512.0), np.arange(1e6)
    for number in range(10_000):
        small[number % 512] += len(str(number))
    for _ in range(1_000):
        np.sort(small[::-1]) @ small
    for _ in range(4):
        np.sqrt(large).sum()
    return 1e3 * (time.process_time() - begun)
