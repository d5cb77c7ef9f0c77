"""How far apart two harmonic signatures are."""

from enum import StrEnum


class Distance(StrEnum):
    """How far apart two harmonic signatures g and G are, `max` their best correlation.

    `plain` is |g|^2 + |G|^2 - 2 max, `normalised` 1 - max / (|g| |G|).
    """

    PLAIN = "plain"
    NORMALISED = "normalised"
