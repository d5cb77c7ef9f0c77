"""A scan's signature: what a vehicle sends instead of its scan (paper, sec. 2.3)."""

import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.arrays import Complex64Array, Float32Array, FloatArray, frozen
from core.errors import InvalidSignature

__all__ = [
    "REVISION_PREFIX_BYTES",
    "Packing",
    "Signature",
    "pack_signatures",
    "unpack_signatures",
]

REVISION_PREFIX_BYTES = 8
"""How much of the digest of a basis or revision a packed query carries: 64 bits name one among
billions."""

_HEADER = struct.Struct("<B8sBB")  # layout, revision prefix, r1, r2
_SEGMENT = struct.Struct("<H")
_SCALE = struct.Struct("<f")
_MAX_SEGMENT = 2**31 - 1
_FLOAT16, _FLOAT32, _HARMONIC_FLOAT16, _HARMONIC_INT8 = 1, 2, 3, 4
_INT8_MAX = 127
_DTYPES: dict[int, np.dtype[np.floating[Any]]] = {
    _FLOAT16: np.dtype("<f2"),
    _FLOAT32: np.dtype("<f4"),
}


class Packing(StrEnum):
    """How the numbers of a packed signature are written."""

    FLOAT16 = "float16"
    INT8 = "int8"


@dataclass(frozen=True, eq=False)
class Signature:
    """One core tensor slice, G~ = U^T S V in the bases of one segment, or U^T S F of a whole map.

    Attributes:
        values: `(r1, r2)`, finite; float32, or complex64 with a real first column if harmonic.
        segment: Whose bases made it; in another segment's the numbers say nothing. `None` if
            harmonic: that basis is the whole map's.
        revision: Digest (or its first digits) of the basis that made it, or of a map revision
            that holds it: two digests are never the same, so one field names either.
    """

    values: Float32Array | Complex64Array
    segment: int | None
    revision: str

    def __post_init__(self) -> None:
        dtype = np.float32 if self.segment is not None else np.complex64
        if self.segment is not None and np.iscomplexobj(self.values):
            raise InvalidSignature("complex values are harmonic, and of no segment")
        # Beyond float32 is infinite, and a signalling NaN is a NaN: both are refused below.
        with np.errstate(over="ignore", invalid="ignore"):
            values = np.asarray(self.values, dtype=dtype)
        if values.ndim != 2 or values.size == 0:
            raise InvalidSignature(f"values has shape {values.shape}, wanted (r1, r2)")
        if not np.isfinite(values).all():
            raise InvalidSignature("values holds numbers that are not finite")
        if self.segment is None and values[:, 0].imag.any():
            raise InvalidSignature("the first column of a harmonic signature is real")
        if self.segment is not None and not 0 <= self.segment <= _MAX_SEGMENT:
            raise InvalidSignature(f"segment is {self.segment}, wanted 0..{_MAX_SEGMENT}")
        object.__setattr__(self, "values", frozen(values, dtype))


def pack_signatures(signatures: Sequence[Signature], packing: Packing | None = None) -> bytes:
    """Pack signatures of one revision for the road.

    11 bytes of header; then for the paper's signatures 2 + 2 r1 r2 bytes each, the values rounded
    to float16 (one part in 2048) or, if one is beyond float16's range, kept as float32. A harmonic
    one is r1 (2 r2 - 1) numbers: by default a scale and one byte each (`int8`, the whole root of
    a number, 127 of the largest), or two (`float16`). Layout: docs/reference/signature.md.

    Args:
        signatures: At least one.
        packing: How numbers are written; by default `int8` if harmonic, else `float16`.

    Raises:
        InvalidSignature: If there is none, revisions or shapes differ, the revision is none, or
            they cannot be packed that way.

    Examples:
        >>> one = Signature(np.eye(5, dtype=np.float32), segment=3, revision="0f" * 32)
        >>> len(pack_signatures([one]))
        63
        >>> harmonic = Signature(np.eye(5, dtype=np.complex64), segment=None, revision="0f" * 32)
        >>> len(pack_signatures([harmonic])), len(pack_signatures([harmonic], Packing.FLOAT16))
        (60, 101)
    """
    if not signatures:
        raise InvalidSignature("there is no signature to pack")
    first = signatures[0]
    if any(s.revision != first.revision for s in signatures):
        raise InvalidSignature("signatures of several revisions cannot be packed together")
    if any(s.values.shape != first.values.shape for s in signatures):
        raise InvalidSignature("signatures of several shapes cannot be packed together")
    segments = [s.segment for s in signatures if s.segment is not None]
    r1, r2 = first.values.shape
    if max(r1, r2) > 255 or max(segments, default=0) > 0xFFFF:
        raise InvalidSignature("ranks up to 255 and segments up to 65535 can be packed")
    prefix = _revision_prefix(first.revision)
    if len(segments) < len(signatures):
        if len(signatures) > 1:
            raise InvalidSignature("a harmonic signature is packed alone")
        layout, numbers = _harmonic_numbers(first, packing or Packing.INT8)
        return _HEADER.pack(layout, prefix, r1, r2) + numbers
    if packing == Packing.INT8:
        raise InvalidSignature("only a harmonic signature is packed as int8")
    largest = max(float(np.abs(s.values).max()) for s in signatures)
    layout = _FLOAT16 if largest <= float(np.finfo(np.float16).max) else _FLOAT32
    parts = [_HEADER.pack(layout, prefix, r1, r2)]
    for s, segment in zip(signatures, segments, strict=True):
        parts += [_SEGMENT.pack(segment), s.values.astype(_DTYPES[layout]).tobytes()]
    return b"".join(parts)


def _harmonic_numbers(signature: Signature, packing: Packing) -> tuple[int, bytes]:
    """Return the layout and the numbers: the first column, then real and imaginary parts."""
    values = signature.values
    numbers = np.concatenate(
        [values[:, 0].real, values[:, 1:].real.ravel(), values[:, 1:].imag.ravel()]
    ).astype(np.float64)
    largest = float(np.abs(numbers).max())
    if packing == Packing.FLOAT16:
        if largest > float(np.finfo(np.float16).max):
            raise InvalidSignature(f"{largest:.3g} is beyond float16; int8 carries a scale")
        return _HARMONIC_FLOAT16, numbers.astype("<f2").tobytes()
    # Whole roots, not whole numbers: a few numbers are large and many small, and these tell places
    # apart. Near 0 a step is a hundredth of what it is with even steps, at the largest twice that.
    scale = float(np.float32(largest / _INT8_MAX**2))
    if scale == 0.0:
        return _HARMONIC_INT8, _SCALE.pack(0.0) + bytes(len(numbers))
    roots = np.minimum(np.rint(np.sqrt(np.abs(numbers) / scale)), _INT8_MAX)
    signed = np.copysign(roots, numbers).astype(np.int8)
    return _HARMONIC_INT8, _SCALE.pack(scale) + signed.tobytes()


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
    if layout not in {*_DTYPES, _HARMONIC_FLOAT16, _HARMONIC_INT8}:
        raise InvalidSignature(
            f"layout {layout} is unknown, wanted 1 (float16), 2 (float32), 3 (harmonic float16)"
            " or 4 (harmonic int8)"
        )
    if r1 == 0 or r2 == 0:
        raise InvalidSignature(f"the ranks are {r1} x {r2}, wanted at least 1 x 1")
    if layout not in _DTYPES:
        return (_unpack_harmonic(layout, body[_HEADER.size :], r1, r2, prefix.hex()),)
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


def _unpack_harmonic(layout: int, body: bytes, r1: int, r2: int, revision: str) -> Signature:
    count = r1 * (2 * r2 - 1)
    wanted = 2 * count if layout == _HARMONIC_FLOAT16 else _SCALE.size + count
    if len(body) != wanted:
        raise InvalidSignature(
            f"{_HEADER.size + len(body)} bytes came, wanted {_HEADER.size + wanted}"
        )
    numbers: FloatArray
    if layout == _HARMONIC_FLOAT16:
        numbers = np.frombuffer(body, "<f2").astype(np.float64)
    else:
        (scale,) = _SCALE.unpack_from(body)
        with np.errstate(invalid="ignore"):  # infinity times 0, refused with all that is not finite
            roots = np.frombuffer(body, np.int8, offset=_SCALE.size).astype(np.float64)
            numbers = scale * roots * np.abs(roots)
    first, real, imag = np.split(numbers, [r1, r1 * r2])
    values: NDArray[np.complex128] = np.zeros((r1, r2), np.complex128)
    values[:, 0] = first
    # Part by part: infinity times 1j would make a NaN of the other part.
    values.real[:, 1:], values.imag[:, 1:] = real.reshape(r1, -1), imag.reshape(r1, -1)
    return Signature(values, None, revision)  # type: ignore[arg-type]  # rounded to complex64 there
