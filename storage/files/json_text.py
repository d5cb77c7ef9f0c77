"""JSON in files: valid text, of limited depth."""

import json
from typing import Any

from storage.errors import CorruptFile

MOST_JSON_BYTES = 2**22
"""Attributes of a map take some thousand bytes; parsed JSON may take thirty times its size."""

_MOST_LEVELS = 16


def parse_json(text: str, name: str) -> Any:  # noqa: ANN401 - JSON is of any kind
    """Return what a JSON text holds.

    Args:
        text: The text.
        name: What it is, for errors.

    Raises:
        CorruptFile: If it is no JSON, nested deeper than 16 levels, or a string in it is no valid
            Unicode: half a surrogate pair cannot be encoded.
    """
    try:
        found = json.loads(text)
    except RecursionError as error:
        raise CorruptFile(f"{name} is nested too deep") from error
    except ValueError as error:
        raise CorruptFile(f"{name} is no JSON: {error}") from error
    level = [found]
    for _ in range(_MOST_LEVELS):
        level = [item for value in level for item in _items(value, name)]
        if not level:
            return found
    raise CorruptFile(f"{name} is nested deeper than {_MOST_LEVELS} levels")


def _items(value: object, name: str) -> list[object]:
    """Return the items of a value, one level deeper."""
    if isinstance(value, dict):
        return [*value.keys(), *value.values()]
    if isinstance(value, list):
        return value
    if isinstance(value, str):
        try:
            value.encode()
        except UnicodeEncodeError as error:
            raise CorruptFile(f"{name} holds text that is no valid Unicode") from error
    return []
