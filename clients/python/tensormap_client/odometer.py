"""The distance that a vehicle travelled since an observation that the service has."""

import math
from collections import OrderedDict

FARTHEST_M = 1e6
"""Between two observations: the service rejects more, which would be sent again."""
_MOST = 10_000  # observations: more than a quarter of an hour at 10 Hz


class Odometer:
    """Sums of odometry, by the number of the observation that they were given with."""

    def __init__(self) -> None:
        self._total_m = 0.0
        self._at_m: OrderedDict[int, float] = OrderedDict()

    def add(self, sequence: int, travelled_m: float | None) -> None:
        """Add an observation's distance; `None`, NaN or infinity is an unknown one."""
        if travelled_m is None or not math.isfinite(travelled_m):
            self._at_m.clear()
        else:
            self._total_m += float(travelled_m)  # a float32 of NumPy would make the sum one
        self._at_m[sequence] = self._total_m
        if len(self._at_m) > _MOST:
            self._at_m.popitem(last=False)

    def since(self, sequence: int | None) -> float | None:
        """Return the distance from an observation to the last one, `None` if it is not known.

        One beyond `FARTHEST_M` counts as unknown.
        """
        if sequence is None or sequence not in self._at_m:
            return None
        travelled_m = self._total_m - self._at_m[sequence]
        return travelled_m if abs(travelled_m) <= FARTHEST_M else None
