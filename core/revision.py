"""The digest that names a map's content."""

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray


def content_digest(arrays: Mapping[str, NDArray[Any]], attributes: Mapping[str, object]) -> str:
    """Return the SHA-256 of named arrays and attributes, 64 hexadecimal digits.

    Everything that is hashed is preceded by its length, in the order of names, so that no two
    contents run into each other: for an array its name, little-endian dtype, shape and bytes; for
    the attributes their canonical JSON.

    Examples:
        >>> content_digest({"a": np.array([1.0])}, {}) == content_digest({"b": np.array([1.0])}, {})
        False
    """
    digest = hashlib.sha256()

    def add(part: bytes) -> None:
        digest.update(len(part).to_bytes(8, "little"))
        digest.update(part)

    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        array = array.astype(array.dtype.newbyteorder("<"), copy=False)
        content = array.reshape(-1).view(np.uint8)  # no copy: large arrays are pages of their file
        add(name.encode())
        add(array.dtype.str.encode())
        add(json.dumps(array.shape).encode())
        digest.update(content.nbytes.to_bytes(8, "little"))
        digest.update(content.data)
    add(json.dumps(dict(attributes), sort_keys=True, separators=(",", ":")).encode())
    return digest.hexdigest()
