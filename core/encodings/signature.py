"""A signature, which a vehicle sends instead of its scan, and its packing."""

import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from numbers import Integral

import numpy as np

from core.arrays import Complex64Array, Float32Array, frozen
from core.encodings.registry import encoding_named, encoding_of_layout
from core.errors import InvalidSignature
from core.projection.visibility import FULL_VIEW, View

REVISION_PREFIX_BYTES = 8
"""Bytes of a digest that a packed query has: 64 bits are unique among billions."""

_HEADER = struct.Struct("<B8sBB")  # layout, revision prefix, r1, r2
HEADER_BYTES = _HEADER.size
"""Size of the header of a packed query, before what the encoding writes."""

LARGEST = 1e33
"""Largest number: above any image's, and products with a map's numbers are finite in float32."""

_MAX_SEGMENT = 2**31 - 1


class Packing(StrEnum):
    """How the numbers of a packed signature are written."""

    FLOAT16 = "float16"
    INT8 = "int8"


@dataclass(frozen=True, eq=False)
class Signature:
    """One core tensor slice, G~ = U^T S V in the bases of one segment, or U^T S F of a whole map.

    Attributes:
        values: `(r1, r2)`, up to `LARGEST`; float32, or complex64 with a real first column if
            harmonic.
        segment: The segment of its bases, only with which it is comparable. `None` if the basis is
            the whole map's.
        revision: Digest (or its first digits) of its basis, or of a map revision that has it: no
            two digests are equal, so one field names either.
        encoding: The encoding's name; by default the paper's with a segment, the harmonic one
            without.
        view: What its scan saw; the values are of that part of its image.
    """

    values: Float32Array | Complex64Array
    segment: int | None
    revision: str
    encoding: str = ""
    view: View = FULL_VIEW

    def __post_init__(self) -> None:
        if not self.encoding:
            object.__setattr__(self, "encoding", "harmonic" if self.segment is None else "paper")
        encoding = encoding_named(self.encoding)
        dtype = encoding.signature_dtype
        if dtype.kind != "c" and np.iscomplexobj(self.values):
            raise InvalidSignature("complex values are harmonic, without a segment")
        if encoding.per_segment != (self.segment is not None):
            wanted = "a" if encoding.per_segment else "no"
            raise InvalidSignature(f"a {self.encoding} signature has {wanted} segment")
        # Beyond float32 is infinite, and a signalling NaN is a NaN: both are rejected below.
        with np.errstate(over="ignore", invalid="ignore"):
            values = np.asarray(self.values, dtype=dtype)
            sane = bool((np.abs(values) <= LARGEST).all())
        if values.ndim != 2 or values.size == 0:
            raise InvalidSignature(f"values has shape {values.shape}, wanted (r1, r2)")
        if not sane:
            raise InvalidSignature(f"values has numbers that are not finite, or beyond {LARGEST:g}")
        encoding.require_values(values)
        if self.segment is not None and not (
            isinstance(self.segment, Integral) and 0 <= self.segment <= _MAX_SEGMENT
        ):
            raise InvalidSignature(
                f"segment is {self.segment!r}, wanted a whole number, 0..{_MAX_SEGMENT}"
            )
        object.__setattr__(self, "values", frozen(values, dtype))
        if not self.view.is_full and not encoding.masks:
            raise InvalidSignature(f"a {self.encoding} signature is of a full view")


def pack_signatures(signatures: Sequence[Signature], packing: Packing | None = None) -> bytes:
    """Pack signatures of one revision for the wire.

    11 bytes of header; then for the paper's signatures 2 + 2 r1 r2 bytes each, the values rounded
    to float16 (one part in 2048) or, if one is beyond float16's range, in float32. A harmonic one
    is r1 (2 r2 - 1) numbers: by default a scale and one byte each (`int8`, the rounded root of a
    number, 127 for the largest), or two (`float16`). Layout: docs/reference/signature.md.

    Args:
        signatures: The signatures, at least one.
        packing: How numbers are written; by default `int8` if harmonic, else `float16`.

    Raises:
        InvalidSignature: If there is none, revisions or shapes differ, the revision is not a
            digest, or they cannot be packed that way.

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
    if any(s.encoding != first.encoding for s in signatures):
        raise InvalidSignature("signatures of several encodings cannot be packed together")
    r1, r2 = first.values.shape
    if max(r1, r2) > 255 or max((s.segment or 0 for s in signatures), default=0) > 0xFFFF:
        raise InvalidSignature("ranks up to 255 and segments up to 65535 can be packed")
    prefix = _revision_prefix(first.revision)
    encoding = encoding_named(first.encoding)
    layout, numbers = encoding.pack(signatures, packing or encoding.packings[0])
    return _HEADER.pack(layout, prefix, r1, r2) + numbers


def _revision_prefix(revision: str) -> bytes:
    if not re.match(f"[0-9a-f]{{{2 * REVISION_PREFIX_BYTES}}}", revision):
        raise InvalidSignature(
            f"the revision is {revision!r}, wanted {2 * REVISION_PREFIX_BYTES} or more hex digits"
        )
    return bytes.fromhex(revision[: 2 * REVISION_PREFIX_BYTES])


def unpack_signatures(body: bytes | bytearray | memoryview) -> tuple[Signature, ...]:
    """Return packed signatures; `revision` is the 16 digits that were sent.

    Raises:
        InvalidSignature: If the bytes are not of that layout.
    """
    if not isinstance(body, bytes):
        try:
            body = bytes(memoryview(body))
        except TypeError:
            raise InvalidSignature(f"wanted bytes, got {type(body).__name__}") from None
    if len(body) < _HEADER.size:
        raise InvalidSignature(f"wanted {_HEADER.size} bytes or more, got {len(body)}")
    layout, prefix, r1, r2 = _HEADER.unpack_from(body)
    encoding = encoding_of_layout(layout)
    if r1 == 0 or r2 == 0:
        raise InvalidSignature(f"the ranks are {r1} x {r2}, wanted at least 1 x 1")
    return encoding.unpack(layout, body[_HEADER.size :], (r1, r2), prefix.hex())
