"""Packed signatures of segments: float16, or float32 where that cannot hold a number."""

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

from core.encodings.signature import HEADER_BYTES, Packing, Signature
from core.errors import InvalidSignature

_FLOAT16, _FLOAT32 = 1, 2
LAYOUTS = {_FLOAT16: "float16", _FLOAT32: "float32"}
_DTYPES: dict[int, np.dtype[np.floating[Any]]] = {
    _FLOAT16: np.dtype("<f2"),
    _FLOAT32: np.dtype("<f4"),
}
_SEGMENT = struct.Struct("<H")


def pack(signatures: Sequence[Signature], packing: Packing) -> tuple[int, bytes]:
    """Return the layout, and each signature's segment and numbers.

    Raises:
        InvalidSignature: If `packing` is not float16.
    """
    if packing != Packing.FLOAT16:
        raise InvalidSignature(f"only a harmonic signature is packed as {packing}")
    largest = max(float(np.abs(s.values).max()) for s in signatures)
    layout = _FLOAT16 if largest <= float(np.finfo(np.float16).max) else _FLOAT32
    parts = []
    for s in signatures:
        parts += [_SEGMENT.pack(s.segment), s.values.astype(_DTYPES[layout]).tobytes()]
    return layout, b"".join(parts)


def unpack(
    layout: int, body: bytes, shape: tuple[int, int], revision: str
) -> tuple[Signature, ...]:
    """Read what `pack` gave.

    Raises:
        InvalidSignature: If the bytes are not of that layout.
    """
    r1, r2 = shape
    dtype = _DTYPES[layout]
    size = _SEGMENT.size + r1 * r2 * dtype.itemsize
    count, rest = divmod(len(body), size)
    if rest or not count:
        raise InvalidSignature(
            f"{HEADER_BYTES + len(body)} bytes came, wanted {HEADER_BYTES} and then {size} for each"
            " signature"
        )
    signatures = []
    for start in range(0, len(body), size):
        (segment,) = _SEGMENT.unpack_from(body, start)
        values = np.frombuffer(body, dtype, r1 * r2, start + _SEGMENT.size)
        signatures.append(Signature(values.reshape(r1, r2), segment, revision))
    return tuple(signatures)
