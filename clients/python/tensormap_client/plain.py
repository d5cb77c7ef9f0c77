"""Arguments as they are sent: NumPy's numbers and arrays become Python's."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from tensormap_client.errors import InvalidArgument


def json_body(value: object) -> bytes:
    """Return a value as JSON.

    Raises:
        InvalidArgument: If JSON has no such value.

    Examples:
        >>> json_body({"segments": np.int64(5), "ranks": np.array([5, 5])})
        b'{"segments":5,"ranks":[5,5]}'
    """
    try:
        text = json.dumps(
            value, ensure_ascii=False, separators=(",", ":"), allow_nan=False, default=_plain
        )
        return text.encode()
    except (TypeError, ValueError) as error:
        raise InvalidArgument(f"it cannot be sent as JSON: {error}") from error


def query(params: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the parameters of a query; an array is a list of values of one name."""
    return {name: _plain_if_numpy(value) for name, value in params.items()}


def given(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values that are not `None`: a parameter or field that is left out."""
    return {name: value for name, value in values.items() if value is not None}


def _plain(value: object) -> object:
    plain = _plain_if_numpy(value)
    if plain is value:
        raise TypeError(f"{value!r:.80} is no number, text, list or mapping")
    return plain


def _plain_if_numpy(value: object) -> object:
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else value
