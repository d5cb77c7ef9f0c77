"""Checks of parameters that are numbers; and unknown numbers, NaN in arrays, elsewhere `None`."""

import math
from collections.abc import Iterable
from numbers import Integral

from core.errors import InvalidParameters


def require_at_least(least: float, **numbers: float | None) -> None:
    """Raise `InvalidParameters` unless each number is finite and at least `least`, or `None`.

    Examples:
        >>> require_at_least(1, segments=0)
        Traceback (most recent call last):
        core.errors.InvalidParameters: segments is 0, wanted at least 1
    """
    for name, number in numbers.items():
        if number is not None and not least <= number < math.inf:
            raise InvalidParameters(f"{name} is {number}, wanted at least {least}")


def require_whole(**numbers: object) -> None:
    """Raise `InvalidParameters` unless each number is a whole one, Python's or NumPy's, or `None`.

    Examples:
        >>> require_whole(segments=2.5)
        Traceback (most recent call last):
        core.errors.InvalidParameters: segments is 2.5, wanted a whole number
    """
    for name, number in numbers.items():
        if number is not None and not isinstance(number, Integral):
            raise InvalidParameters(f"{name} is {number!r:.80}, wanted a whole number")


def require_above(bound: float, **numbers: float | None) -> None:
    """Raise `InvalidParameters` unless each number is finite and above `bound`, or `None`."""
    for name, number in numbers.items():
        if number is not None and not bound < number < math.inf:
            raise InvalidParameters(f"{name} is {number}, wanted a finite number above {bound}")


def require_finite(**numbers: float | None) -> None:
    """Raise `InvalidParameters` unless each number is finite, or `None`."""
    for name, number in numbers.items():
        if number is not None and not math.isfinite(number):
            raise InvalidParameters(f"{name} is {number}, wanted a finite number")


def numbers_of(words: Iterable[str]) -> list[float]:
    """Return the numbers that words say in plain digits; `float` takes `1_0` for 10 as well.

    Raises:
        ValueError: If one is no number.

    Examples:
        >>> numbers_of(["1.5", "-2e3"])
        [1.5, -2000.0]
    """
    words = list(words)
    for word in words:
        if "_" in word or not word.isascii():
            raise ValueError(f"could not convert string to float: {word!r}")
    return [float(word) for word in words]


def none_if_nan(number: float) -> float | None:
    """Return a number of an array, `None` if it is unknown there."""
    return None if math.isnan(number) else float(number)


def nan_if_none(number: float | None) -> float:
    """Return a number for an array, NaN if it is unknown."""
    return math.nan if number is None else number
