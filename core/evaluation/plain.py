"""Results as plain values, ready for JSON."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np


class Plain:
    """A dataclass of results.

    Attributes:
        json_names: Names that fields have in JSON, by their own, where these differ.

    Examples:
        >>> from dataclasses import dataclass
        >>> @dataclass
        ... class Counts(Plain):
        ...     counted: int
        ...     json_names = {"counted": "judged"}
        >>> Counts(3).as_dict()
        {'judged': 3}
    """

    json_names: ClassVar[Mapping[str, str]] = MappingProxyType({})

    def as_dict(self) -> dict[str, Any]:
        """Return plain values, ready for JSON."""
        names = ((f.name, self.json_names.get(f.name, f.name)) for f in fields(self))  # type: ignore[arg-type]
        return {in_json: plain(getattr(self, name)) for name, in_json in names}


def plain(value: Any) -> Any:  # noqa: ANN401 - whatever a figure may be
    """Return a value as JSON has it.

    An unknown number, NaN, is `None`; of distances in metres that are keys, the shortest text.

    Examples:
        >>> plain({3.0: np.array([1.5, np.nan])})
        {'3': [1.5, None]}
    """
    if isinstance(value, Plain):
        return value.as_dict()
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, dict):
        return {
            f"{key:g}" if isinstance(key, float) else key: plain(item)
            for key, item in value.items()
        }
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, Enum):
        return value.value
    if is_dataclass(value):
        return {f.name: plain(getattr(value, f.name)) for f in fields(value)}
    return None if value != value else value
