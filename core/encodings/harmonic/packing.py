"""A packed harmonic signature: r1 (2 r2 - 1) numbers, in two bytes each or in one and a scale."""

import struct
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from core.arrays import FloatArray
from core.encodings.signature import HEADER_BYTES, Packing, Signature
from core.errors import InvalidSignature

_FLOAT16, _INT8 = 3, 4
LAYOUTS = {_FLOAT16: "harmonic float16", _INT8: "harmonic int8"}
_SCALE = struct.Struct("<f")
_INT8_MAX = 127


def pack(signatures: Sequence[Signature], packing: Packing) -> tuple[int, bytes]:
    """Return the layout and the numbers: the first column, then real and imaginary parts.

    Raises:
        InvalidSignature: If there are several, or a number is beyond float16.
    """
    if len(signatures) > 1:
        raise InvalidSignature("a harmonic signature is packed alone")
    values = signatures[0].values
    numbers = np.concatenate(
        [values[:, 0].real, values[:, 1:].real.ravel(), values[:, 1:].imag.ravel()]
    ).astype(np.float64)
    largest = float(np.abs(numbers).max())
    if packing == Packing.FLOAT16:
        if largest > float(np.finfo(np.float16).max):
            raise InvalidSignature(f"{largest:.3g} is beyond float16; int8 carries a scale")
        return _FLOAT16, numbers.astype("<f2").tobytes()
    # Whole roots, not whole numbers: a few numbers are large and many small, and these tell places
    # apart. Near 0 a step is a hundredth of what it is with even steps, at the largest twice that.
    scale = float(np.float32(largest / _INT8_MAX**2))
    if scale == 0.0:
        return _INT8, _SCALE.pack(0.0) + bytes(len(numbers))
    roots = np.minimum(np.rint(np.sqrt(np.abs(numbers) / scale)), _INT8_MAX)
    signed = np.copysign(roots, numbers).astype(np.int8)
    return _INT8, _SCALE.pack(scale) + signed.tobytes()


def unpack(
    layout: int, body: bytes, shape: tuple[int, int], revision: str
) -> tuple[Signature, ...]:
    """Read what `pack` gave.

    Raises:
        InvalidSignature: If the bytes are not of that layout.
    """
    r1, r2 = shape
    count = r1 * (2 * r2 - 1)
    wanted = 2 * count if layout == _FLOAT16 else _SCALE.size + count
    if len(body) != wanted:
        raise InvalidSignature(
            f"{HEADER_BYTES + len(body)} bytes came, wanted {HEADER_BYTES + wanted}"
        )
    numbers: FloatArray
    if layout == _FLOAT16:
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
    # Rounded to complex64 there.
    return (Signature(values, None, revision),)  # type: ignore[arg-type]
