"""Packed harmonic signatures: one of a scan, byte by byte (docs/reference/signature.md)."""

import struct

import numpy as np

from core.arrays import FloatArray
from core.encodings.signature import HEADER_BYTES, Packing, Signature
from core.errors import InvalidSignature
from core.projection.visibility import FULL_VIEW, View

_FLOAT16, _INT8 = 3, 4  # layouts
_PARTIAL_INT8, _PARTIAL_FLOAT16 = 5, 6  # with their view
_VIEW_BYTES, _SHORT_SCALE_BYTES = 8, 2
_SCALE = struct.Struct("<f")
_INT8_MAX = 127

LAYOUTS = {
    _FLOAT16: "harmonic float16",
    _INT8: "harmonic int8",
    _PARTIAL_INT8: "harmonic int8, partial view",
    _PARTIAL_FLOAT16: "harmonic float16, partial view",
}
"""What a packed signature can be, by the first byte of its header."""


def pack(signature: Signature, packing: Packing) -> tuple[int, bytes]:
    """Return the layout and the numbers: the first column, then real and imaginary parts.

    Before them the 8 bytes of `View.bits`, if its view is partial.

    Raises:
        InvalidSignature: If a number is beyond float16.
    """
    values = signature.values
    numbers = np.concatenate(
        [values[:, 0].real, values[:, 1:].real.ravel(), values[:, 1:].imag.ravel()]
    ).astype(np.float64)
    as_float16, view = packing == Packing.FLOAT16, signature.view
    if view.is_full:
        return (_FLOAT16, _as_float16(numbers)) if as_float16 else (_INT8, _as_int8(numbers, 4))
    packed = view.bits.to_bytes(_VIEW_BYTES, "little")
    if as_float16:
        return _PARTIAL_FLOAT16, packed + _as_float16(numbers)
    return _PARTIAL_INT8, packed + _as_int8(numbers, _SHORT_SCALE_BYTES)


def unpack(layout: int, body: bytes, shape: tuple[int, int], revision: str) -> Signature:
    """Read what `pack` returned.

    Args:
        layout: One of `LAYOUTS`.
        body: What follows the header.
        shape: `(r1, r2)`.
        revision: What the signature names.

    Raises:
        InvalidSignature: If the bytes are not of that layout.
    """
    r1, r2 = shape
    count = r1 * (2 * r2 - 1)
    as_float16 = layout in {_FLOAT16, _PARTIAL_FLOAT16}
    partial = layout in {_PARTIAL_INT8, _PARTIAL_FLOAT16}
    view_bytes = _VIEW_BYTES if partial else 0
    scale_bytes = _SHORT_SCALE_BYTES if partial else _SCALE.size
    wanted = view_bytes + (2 * count if as_float16 else scale_bytes + count)
    if len(body) != wanted:
        raise InvalidSignature(
            f"wanted {HEADER_BYTES + wanted} bytes, got {HEADER_BYTES + len(body)}"
        )
    bits, body = int.from_bytes(body[:view_bytes], "little"), body[view_bytes:]
    view = View.of_bits(bits) if partial else FULL_VIEW
    if as_float16:
        numbers: FloatArray = np.frombuffer(body, "<f2").astype(np.float64)
    else:
        (scale,) = _SCALE.unpack(body[:scale_bytes].rjust(_SCALE.size, b"\0"))
        if scale < 0.0:
            raise InvalidSignature(f"the scale of its numbers is {scale:g}, wanted 0 or more")
        with np.errstate(invalid="ignore"):  # infinity times 0: NaN, rejected as not finite
            roots = np.frombuffer(body, np.int8, offset=scale_bytes).astype(np.float64)
            numbers = scale * roots * np.abs(roots)
    first, real, imag = numbers[:r1], numbers[r1 : r1 * r2], numbers[r1 * r2 :]
    values = np.zeros((r1, r2), np.complex64)
    # Beyond float32 is infinite, and a signalling NaN is a NaN: both are rejected.
    with np.errstate(over="ignore", invalid="ignore"):
        values.real[:, 0] = first
        # Part by part: infinity times 1j would make a NaN of the other part.
        values.real[:, 1:], values.imag[:, 1:] = real.reshape(r1, -1), imag.reshape(r1, -1)
    return Signature(values, None, revision, view=view)


def _as_float16(numbers: FloatArray) -> bytes:
    largest = float(np.abs(numbers).max())
    if largest > float(np.finfo(np.float16).max):
        raise InvalidSignature(f"{largest:.3g} is beyond float16; int8 carries a scale")
    return numbers.astype("<f2").tobytes()


def _as_int8(numbers: FloatArray, scale_bytes: int) -> bytes:
    # Rounded roots, not rounded numbers: most numbers are small, and places differ by these.
    # Near 0 a step is a hundredth of an even step, at the largest number twice an even step.
    packed = _SCALE.pack(float(np.abs(numbers).max()) / _INT8_MAX**2)
    if scale_bytes < _SCALE.size:  # the upper half of the float32, rounded up
        whole = int.from_bytes(packed, "little") + 0xFFFF
        packed = (whole & ~0xFFFF).to_bytes(_SCALE.size, "little")
    scale: float = _SCALE.unpack(packed)[0]
    roots = np.zeros_like(numbers)
    if scale > 0.0:
        roots = np.minimum(np.rint(np.sqrt(np.abs(numbers) / scale)), _INT8_MAX)
    return packed[-scale_bytes:] + np.copysign(roots, numbers).astype(np.int8).tobytes()
