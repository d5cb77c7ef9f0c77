"""Which scans of a drive are mapped and which are held out as queries (paper, sec. 3.1)."""

import re
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from core.arrays import BoolArray, IntArray
from core.errors import InvalidParameters
from core.numbers import require_at_least, require_whole


@dataclass(frozen=True)
class Interleaved:
    """Hold out a fraction of every segment, spread evenly: the paper's 80:20.

    Scan j of its segment is a query when floor((j+1) f + 1/2) > floor(j f + 1/2), for f as a
    decimal fraction, without rounding.

    Attributes:
        fraction: f, above 0 and below 1.
        phase: Added to j, to hold out other scans of the same spacing; below the denominator of f,
            after which the scans are the same again.

    Examples:
        >>> np.flatnonzero(Interleaved(0.2).held_out(np.array([0, 10]))).tolist()
        [2, 7]
    """

    fraction: float = 0.2
    phase: int = 0

    def __post_init__(self) -> None:
        if not 0.0 < self.fraction < 1.0:
            raise InvalidParameters(f"the held-out fraction is {self.fraction}, wanted 0 < f < 1")
        require_whole(phase=self.phase)
        phases = self._exact.denominator
        if not 0 <= self.phase < phases:
            raise InvalidParameters(
                f"the phase is {self.phase}, wanted 0 to {phases - 1}: {self.fraction:g} has"
                f" {phases} phases"
            )

    @property
    def _exact(self) -> Fraction:
        """Python's integers: rounding would hold out neighbours of where a fraction is a half."""
        return Fraction(repr(float(self.fraction)))

    def held_out(self, segment_start: IntArray) -> BoolArray:
        """Return which scans of a drive cut at `segment_start` (L + 1,) are queries, `(K,)`."""
        lengths = np.diff(segment_start)
        j = np.arange(lengths.sum()) - np.repeat(segment_start[:-1], lengths) + self.phase
        exact = self._exact
        part, whole = 2 * exact.numerator, 2 * exact.denominator
        before = j.astype(object) * part + exact.denominator
        return np.asarray((before + part) // whole > before // whole, dtype=np.bool_)

    def __str__(self) -> str:
        return f"interleaved:{self.fraction:g}" + (f":{self.phase}" if self.phase else "")


@dataclass(frozen=True)
class Every:
    """Map the scans whose index is divisible by n, query all others.

    Examples:
        >>> np.flatnonzero(Every(3).held_out(np.array([0, 5]))).tolist()
        [1, 2, 4]
    """

    n: int = 2

    def __post_init__(self) -> None:
        require_at_least(2, n=self.n)  # else nothing is held out

    def held_out(self, segment_start: IntArray) -> BoolArray:
        """Return which scans are queries, `(K,)`."""
        return np.asarray(np.arange(segment_start[-1]) % self.n != 0)

    def __str__(self) -> str:
        return f"every:{self.n}"


Split = Interleaved | Every
"""Which scans of a drive are held out."""


def parse_split(text: str) -> Split:
    """Read `interleaved:0.2`, `interleaved:0.2:PHASE` or `every:2`.

    Raises:
        InvalidParameters: If the text has neither form.

    Examples:
        >>> parse_split("interleaved:0.2"), parse_split("every:2")
        (Interleaved(fraction=0.2, phase=0), Every(n=2))
    """
    if match := re.fullmatch(r"interleaved:(0?\.\d+)(?::(\d{1,9}))?", text):
        return Interleaved(float(match[1]), int(match[2] or 0))
    if match := re.fullmatch(r"every:(\d{1,9})", text):
        return Every(int(match[1]))
    raise InvalidParameters(
        f"the split is {text!r}, wanted interleaved:FRACTION, interleaved:FRACTION:PHASE or every:N"
    )
