"""Results as plain values, ready for JSON."""

from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any

import numpy as np


class Plain:
    """A dataclass of results."""

    def as_dict(self) -> dict[str, Any]:
        """Return plain values, ready for JSON."""
        return {f.name: plain(getattr(self, f.name)) for f in fields(self)}  # type: ignore[arg-type]


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
