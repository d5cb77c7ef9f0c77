"""Shapes and kinds of numbers, as messages describe them."""

import math
from typing import Any, Final

import numpy as np

from storage.errors import CorruptFile
from storage.hdf5.source import Fields

_FLOAT32 = bytes.fromhex("11201f000400000000002000170800177f000000")

CODES: Final = {
    "|u1": bytes.fromhex("100000000100000000000800"),
    "|i1": bytes.fromhex("100800000100000000000800"),
    "<i2": bytes.fromhex("100800000200000000001000"),
    "<i4": bytes.fromhex("100800000400000000002000"),
    "<i8": bytes.fromhex("100800000800000000004000"),
    "<f4": _FLOAT32,
    "<f8": bytes.fromhex("11203f000800000000004000340b0034ff030000"),
    # A compound of `r` and `i`, version 1: each name in 8 bytes, offset, no dimensions.
    "<c8": b"".join(
        (
            bytes.fromhex("1602000008000000"),
            b"r".ljust(8, b"\0") + bytes(4 + 12 + 16) + _FLOAT32,
            b"i".ljust(8, b"\0") + bytes.fromhex("04000000") + bytes(12 + 16) + _FLOAT32,
        )
    ),
}
"""How a file describes the numbers that these files hold, all little-endian."""

_TEXT: Final = bytes.fromhex("1901010010000000100000000100000000000800")
"""How a file describes UTF-8 text of variable length."""

# The same in versions 3 to 5, as newer files have it: names end with a zero, offsets take a byte.
_NEWER_COMPLEX = bytes.fromhex("02000008000000") + b"r\0\0" + _FLOAT32 + b"i\0\4" + _FLOAT32
_MOST_AXES = 8
_MOST_NUMBERS = 2**48  # NumPy takes no axis much longer, not even beside one of none
_DTYPES: dict[bytes, np.dtype[Any]] = {code: np.dtype(name) for name, code in CODES.items()}
for _version in (b"\x36", b"\x46", b"\x56"):
    _DTYPES[_version + _NEWER_COMPLEX] = np.dtype("<c8")
_TEXTS = {
    head + base
    for head in (_TEXT[:8], bytes.fromhex("1901000010000000"))  # in UTF-8 or ASCII
    for base in (_TEXT[8:], bytes.fromhex("100800000100000000000800"))
}
_CLASSES = {
    0: "whole numbers",
    1: "floats",
    2: "times",
    3: "text",
    4: "bits",
    5: "opaque bytes",
    6: "a compound",
    7: "references",
    8: "an enumeration",
    9: "items of any length",
    10: "arrays",
    11: "complex numbers",
}


def text_or_dtype(content: bytes, name: str) -> np.dtype[Any] | None:
    """Return the kind of number that is described, `None` for text of variable length.

    Raises:
        CorruptFile: If it is no kind that these files hold.
    """
    return None if content[: len(_TEXT)] in _TEXTS else dtype_of(content, name)


def dtype_of(content: bytes, name: str) -> np.dtype[Any]:
    """Return the kind of number that is described.

    Raises:
        CorruptFile: If it is no kind of number that these files hold.
    """
    for code, dtype in _DTYPES.items():
        # In headers of version 1, messages are filled up with zeros.
        if content.startswith(code) and not any(content[len(code) :]):
            return dtype
    fields = Fields(content, name)
    kind, _, size = fields.unsigned(1), fields.take(3), fields.unsigned(4)
    raise CorruptFile(
        f"{name} holds {_CLASSES.get(kind & 15, 'something unknown')} of {size} bytes each, of a"
        f" kind that is not read here; these are {', '.join(CODES)}"
    )


def shape_of(fields: Fields) -> tuple[int, ...]:
    """Return the lengths of the axes that a message describes; no axis for one number.

    Raises:
        CorruptFile: If there is no number at all, or too many axes.
    """
    version, axes, flags = fields.unsigned(1), fields.unsigned(1), fields.unsigned(1)
    kind = 1
    if version == 1:
        fields.take(5)
    elif version == 2:
        kind = fields.unsigned(1)
    else:
        raise CorruptFile(f"{fields.name}: its shape is of version {version}, wanted 1 or 2")
    if kind not in {0, 1} or (kind == 0 and axes):
        raise CorruptFile(f"{fields.name} is no plain array of numbers: it has no shape")
    if axes > _MOST_AXES or flags & ~1:
        raise CorruptFile(f"{fields.name} has {axes} axes, at most {_MOST_AXES} are read here")
    shape = tuple(fields.unsigned(8) for _ in range(axes))
    if math.prod(length or 1 for length in shape) > _MOST_NUMBERS:
        raise CorruptFile(f"{fields.name} has shape {shape}: more numbers than any file")
    if flags:
        longest = tuple(fields.unsigned(8) for _ in range(axes))
        if any(most < now for now, most in zip(shape, longest, strict=True)):
            raise CorruptFile(f"{fields.name} has shape {shape}, and at most {longest}")
    return shape
