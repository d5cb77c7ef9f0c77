"""Intervals between the observations of a track, and what is usual of them."""

import math
from dataclasses import dataclass, field
from statistics import median

_KEPT = 15  # of the last ones


@dataclass
class Intervals:
    """Intervals between observations by their times, or by their numbers; some may have none.

    Attributes:
        last: Time, or number, of the last observation that had one.
        usual: The last mean intervals from one such observation to the next, at most 15.
        between: How many observations without one came since.
    """

    last: float | None = None
    usual: list[float] = field(default_factory=list)
    between: int = 0

    def since(self, now: float | None) -> float:
        """Return the interval since the last observation, infinite if it is not known.

        Observations in between are taken to have come at the usual interval or, if they would then
        be later than now, evenly.
        """
        if self.last is None or now is None:
            return math.inf
        passed = now - self.last
        evenly = passed / (self.between + 1)
        if not self.between or not self.usual:
            return evenly
        return max(passed - self.between * median(self.usual), evenly)

    def share(self, now: float | None) -> float | None:
        """Return the interval since the last observation as a share of the usual, if known."""
        since = self.since(now)
        if not self.usual or not math.isfinite(since):
            return None
        return since / median(self.usual)  # NumPy takes ten times as long for so few

    def keep(self, now: float | None, *, continues: bool) -> None:
        """Keep a time, and the mean interval since the last one if that is of the same track."""
        if now is None:
            self.between += 1
            return
        if self.last is not None and not continues:
            self.usual.append((now - self.last) / (self.between + 1))
            del self.usual[:-_KEPT]
        self.last, self.between = now, 0
