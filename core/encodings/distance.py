"""The distance of two harmonic signatures."""

from enum import StrEnum


class Distance(StrEnum):
    """The distance of two harmonic signatures g and G, `max` being their best correlation.

    `plain` is |g|^2 + |G|^2 - 2 max, `normalised` 1 - max / (|g| |G|).
    """

    PLAIN = "plain"
    NORMALISED = "normalised"
