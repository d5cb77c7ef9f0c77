"""Packed signatures, byte by byte (signature.md)."""

import struct
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tensormap_client.signature.images import SECTORS, View

_MOST_FLOAT16 = float(np.finfo(np.float16).max)


def pack_harmonic(digest: str, values: NDArray[np.complex64], view: View) -> bytes:
    """Return a harmonic signature in layout 4, or 5 if its view is partial."""
    numbers = np.concatenate(
        [values[:, 0].real, values[:, 1:].real.ravel(), values[:, 1:].imag.ravel()]
    ).astype(np.float64)
    scale = struct.pack("<f", float(np.abs(numbers).max()) / 127**2)
    partial = b""
    if view != View():
        bits = sum(1 << sector for sector in view.hidden) + ((view.rings or 0) << SECTORS)
        partial = bits.to_bytes(8, "little")
        # The upper half of the float32, rounded up.
        scale = bytes(2) + ((int.from_bytes(scale, "little") + 0xFFFF) >> 16).to_bytes(2, "little")
    step: float = struct.unpack("<f", scale)[0]
    roots = np.zeros_like(numbers)
    if step > 0.0:
        roots = np.minimum(np.rint(np.sqrt(np.abs(numbers) / step)), 127.0)
    body = np.copysign(roots, numbers).astype(np.int8).tobytes()
    header = _header(5 if partial else 4, digest, values.shape)
    return header + partial + (scale[2:] if partial else scale) + body


def pack_paper(digest: str, values: NDArray[np.float32], segments: Sequence[int]) -> bytes:
    """Return `(S, r1, r2)` signatures of segments in layout 1, or 2 beyond float16."""
    layout, dtype = (1, "<f2") if float(np.abs(values).max()) <= _MOST_FLOAT16 else (2, "<f4")
    packed = (
        struct.pack("<H", segment) + one.astype(dtype).tobytes()
        for segment, one in zip(segments, values, strict=True)
    )
    return _header(layout, digest, values.shape[1:]) + b"".join(packed)


def _header(layout: int, digest: str, ranks: tuple[int, ...]) -> bytes:
    return struct.pack("<B8sBB", layout, bytes.fromhex(digest)[:8], *ranks)
