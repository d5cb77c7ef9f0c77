"""Dataclasses of numbers that a map file stores as attributes."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, Self

from core.errors import InvalidMap, InvalidParameters


@dataclass(frozen=True)
class Attributes:
    """Base of such dataclasses."""

    def as_attributes(self) -> dict[str, Any]:
        """Return plain values for a file's attributes: lists for tuples, dicts for dataclasses."""
        return asdict(self, dict_factory=_with_lists)

    def _set_numbers(self, name: str, count: int, least: float, most: float) -> None:
        values = tuple(float(value) for value in getattr(self, name))
        object.__setattr__(self, name, values)
        if len(values) != count or not all(least <= value <= most for value in values):
            raise InvalidParameters(
                f"{name} is {values}, wanted {count} numbers {least:g}..{most:g}"
            )

    @classmethod
    def from_attributes(cls, attributes: Mapping[str, Any]) -> Self:
        """Read the values of `as_attributes`.

        Raises:
            InvalidMap: If a value is missing, unknown or of another type.
        """
        try:
            odd = set(attributes) ^ {field.name for field in fields(cls)}
            if odd:
                raise ValueError(f"it lacks or should not hold {', '.join(sorted(odd))}")
            return cls(**attributes)
        except (TypeError, ValueError, OverflowError, InvalidParameters) as error:
            name = cls.__name__.lower()
            raise InvalidMap(f"the map's {name} cannot be read: {error}") from error


def _with_lists(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    return {name: list(value) if isinstance(value, tuple) else value for name, value in pairs}
