"""A scan's signature: what a vehicle sends instead of its scan (paper, sec. 2.3)."""

import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from core.arrays import Float32Array, frozen
from core.errors import InvalidSignature

__all__ = ["REVISION_PREFIX_BYTES", "Signature", "pack_signatures", "unpack_signatures"]

REVISION_PREFIX_BYTES = 8
"""How much of the revision's digest a packed query carries: 64 bits name one among billions."""

_HEADER = struct.Struct("<B8sBB")  # layout, revision prefix, r1, r2
_SEGMENT = struct.Struct("<H")
_MAX_SEGMENT = 2**31 - 1
_FLOAT16, _FLOAT32 = 1, 2
_DTYPES: dict[int, np.dtype[np.floating[Any]]] = {
    _FLOAT16: np.dtype("<f2"),
    _FLOAT32: np.dtype("<f4"),
}


@dataclass(frozen=True, eq=False)
class Signature:
    """One core tensor slice, G~ = U^T S V, in the bases of one segment.

    Attributes:
        values: `(r1, r2)` float32, finite.
        segment: Whose bases made it; in another segment's the numbers say nothing.
        revision: Digest (or its first digits) of the map revision that holds the bases.
    """

    values: Float32Array
    segment: int
    revision: str

    def __post_init__(self) -> None:
        # Beyond float32 is infinite, and a signalling NaN is a NaN: both are refused below.
        with np.errstate(over="ignore", invalid="ignore"):
            values = np.asarray(self.values, dtype=np.float32)
        if values.ndim != 2 or values.size == 0:
            raise InvalidSignature(f"values has shape {values.shape}, wanted (r1, r2)")
        if not np.isfinite(values).all():
            raise InvalidSignature("values holds numbers that are not finite")
        if not 0 <= self.segment <= _MAX_SEGMENT:
            raise InvalidSignature(f"segment is {self.segment}, wanted 0..{_MAX_SEGMENT}")
        object.__setattr__(self, "values", frozen(values, np.float32))


def pack_signatures(signatures: Sequence[Signature]) -> bytes:
    """Pack signatures of one revision for the road: 11 bytes, then 2 + 2 r1 r2 for each.

    Values are rounded to float16 (one part in 2048; a 5x5 signature is 50 bytes of values) or, if
    one is beyond float16's range, kept as float32. Layout: docs/reference/signature.md.

    Raises:
        InvalidSignature: If there is none, revisions or shapes differ, or the revision is none.

    Examples:
        >>> one = Signature(np.eye(5, dtype=np.float32), segment=3, revision="0f" * 32)
        >>> len(pack_signatures([one]))
        63
    """
    if not signatures:
        raise InvalidSignature("there is no signature to pack")
    first = signatures[0]
    if any(s.revision != first.revision for s in signatures):
        raise InvalidSignature("signatures of several revisions cannot be packed together")
    if any(s.values.shape != first.values.shape for s in signatures):
        raise InvalidSignature("signatures of several shapes cannot be packed together")
    r1, r2 = first.values.shape
    if max(r1, r2) > 255 or max(s.segment for s in signatures) > 0xFFFF:
        raise InvalidSignature("ranks up to 255 and segments up to 65535 can be packed")
    largest = max(float(np.abs(s.values).max()) for s in signatures)
    layout = _FLOAT16 if largest <= float(np.finfo(np.float16).max) else _FLOAT32
    prefix = _revision_prefix(first.revision)
    parts = [_HEADER.pack(layout, prefix, r1, r2)]
    for s in signatures:
        parts += [_SEGMENT.pack(s.segment), s.values.astype(_DTYPES[layout]).tobytes()]
    return b"".join(parts)


def _revision_prefix(revision: str) -> bytes:
    if not re.match(f"[0-9a-f]{{{2 * REVISION_PREFIX_BYTES}}}", revision):
        raise InvalidSignature(
            f"the revision is {revision!r}, wanted {2 * REVISION_PREFIX_BYTES} or more hex digits"
        )
    return bytes.fromhex(revision[: 2 * REVISION_PREFIX_BYTES])


def unpack_signatures(body: bytes) -> tuple[Signature, ...]:
    """Read what `pack_signatures` wrote; `revision` holds the 16 digits that were sent.

    Raises:
        InvalidSignature: If the bytes are not of that layout.
    """
    if len(body) < _HEADER.size:
        raise InvalidSignature(f"{len(body)} bytes came, the header alone has {_HEADER.size}")
    layout, prefix, r1, r2 = _HEADER.unpack_from(body)
    if layout not in _DTYPES:
        raise InvalidSignature(f"layout {layout} is unknown, wanted 1 (float16) or 2 (float32)")
    if r1 == 0 or r2 == 0:
        raise InvalidSignature(f"the ranks are {r1} x {r2}, wanted at least 1 x 1")
    dtype = _DTYPES[layout]
    size = _SEGMENT.size + r1 * r2 * dtype.itemsize
    count, rest = divmod(len(body) - _HEADER.size, size)
    if rest or not count:
        raise InvalidSignature(
            f"{len(body)} bytes came, wanted {_HEADER.size} and then {size} for each signature"
        )
    signatures = []
    for start in range(_HEADER.size, len(body), size):
        (segment,) = _SEGMENT.unpack_from(body, start)
        values = np.frombuffer(body, dtype, r1 * r2, start + _SEGMENT.size)
        signatures.append(Signature(values.reshape(r1, r2), segment, prefix.hex()))
    return tuple(signatures)
