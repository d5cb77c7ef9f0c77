"""Numbers of packed answers, in the floats of their layouts."""

import math

_LARGEST_HALF, _LARGEST_SINGLE = 65504.0, 3.4e38


def as_half(value: float | None) -> float:
    """Return a number that 2 bytes take: NaN for none, the largest one for what is beyond it.

    Examples:
        >>> as_half(-1e6), as_half(0.5), as_half(None)
        (-65504.0, 0.5, nan)
    """
    return _within(_LARGEST_HALF, value)


def as_single(value: float | None) -> float:
    """Return a number that 4 bytes take, in the same way."""
    return _within(_LARGEST_SINGLE, value)


def _within(largest: float, value: float | None) -> float:
    return math.nan if value is None else min(max(value, -largest), largest)
