"""NumPy arrays, `.npy`: the first three columns, or the fields x, y and z.

The header is untrusted text: it is parsed as literals of a few kinds, without NumPy's fallbacks
that warn, and what it claims is compared with the body before an array is made.
"""

import ast
import math
import re
import threading
from typing import Any, Literal

import numpy as np
from numpy.lib import format as npy_format

from core.arrays import Float32Array
from storage.formats.budget import BUDGET
from storage.formats.errors import MalformedScan, TruncatedScan, WrongDtype, short
from storage.formats.scans.coordinates import AXES, as_float32, coordinates, require_amount
from storage.formats.scans.scan_format import ScanFormat

_MAGIC = b"\x93NUMPY"
_LENGTH_BYTES = {(1, 0): 2, (2, 0): 4, (3, 0): 4}
_MAX_HEADER_BYTES = 10_000  # NumPy's own limit
_LITERALS = re.compile(r"(?:'[^'\\]*'|\d+(?!\w)|True|False|[{}()\[\],: ])*\n?")
_FLOAT = re.compile(r"[<>=|]?f[248]")
_PLAIN = re.compile(r"[<>=|]?[fiubcSUV?]\d*")
# Python 3.11 counts the depth of a syntax tree for all threads together, and says now and then that
# it does not fit: a `SystemError` of valid text.
_PARSING = threading.Lock()
_MOST_COLUMNS = 100  # far more than any sensor gives of a return
_FLOATS = "float16, float32 or float64 metres"


class NpyFormat(ScanFormat):
    """An array `(n, 3 to 100)` of floats, or a structured one with float fields x, y and z.

    An organised one of either has a return in each of its rows and columns.
    """

    name = "NumPy"
    media_type = "application/vnd.tensormap.npy"
    suffixes = (".npy",)
    magics = (_MAGIC,)

    def read(self, body: bytes) -> Float32Array:
        """Return `(n, 3)` metres, including no-returns. Nothing is unpickled.

        Raises:
            MalformedScan: If the header or the shape is not as expected.
            TruncatedScan: If the array is longer than the body.
            WrongDtype: If the array does not hold floats.

        Examples:
            >>> from io import BytesIO
            >>> file = BytesIO()
            >>> np.save(file, np.array([[10.0, 0.0, -1.0, 0.3]]))
            >>> NpyFormat().read(file.getvalue())
            array([[10.,  0., -1.]], dtype=float32)
        """
        header, start = _header(body)
        dtype, shape = _dtype(header["descr"]), _shape(header["shape"])
        if dtype.names is None:
            _require_columns(shape)
        claimed, given = math.prod(shape) * dtype.itemsize, len(body) - start
        claim = f"shape {short(shape)} of {dtype} takes {short(claimed)} bytes, got {given}"
        require_amount(given, claimed, claim)
        if claimed == 0:
            return np.empty((0, 3), np.float32)
        BUDGET.require_returns(math.prod(shape[:-1] if dtype.names is None else shape))
        values = np.frombuffer(body, dtype=dtype, offset=start)
        if dtype.names is not None:
            return coordinates(values)
        order: Literal["C", "F"] = "F" if header["fortran_order"] else "C"
        return as_float32(values.reshape(shape, order=order)[..., :3].reshape(-1, 3))


def _require_columns(shape: tuple[int, ...]) -> None:
    """Reject the shape of a plain array whose last axis is not that of a return's numbers."""
    wanted = f"wanted (n, 3), up to (n, {_MOST_COLUMNS}), or organised (h, w, 3) or (h, w, 4)"
    # Of an organised array with more the first three may be others, as of a network's input.
    has_others = len(shape) == 3 and 4 < shape[-1] <= _MOST_COLUMNS
    if len(shape) not in {2, 3} or shape[-1] < 3 or has_others:
        raise MalformedScan(f"the array has shape {short(shape)}, {wanted}")
    if shape[-1] > _MOST_COLUMNS:
        perhaps = "transposed" if min(shape) < _MOST_COLUMNS else "a range image"
        raise MalformedScan(f"the array has shape {short(shape)}, {wanted}: is it {perhaps}?")


def _header(body: bytes) -> tuple[dict[str, Any], int]:
    """Return the header and where the array begins."""
    if not body.startswith(_MAGIC):
        raise MalformedScan(f"the body begins with {body[:6]!r}, .npy with {_MAGIC!r}")
    version = tuple(body[6:8])
    if version not in _LENGTH_BYTES:
        raise MalformedScan(f".npy version {version} is unknown, wanted 1.0, 2.0 or 3.0")
    begin = 8 + _LENGTH_BYTES[version]
    length = int.from_bytes(body[8:begin], "little")
    if len(body) < begin + length:
        raise TruncatedScan(f"the header takes {length} bytes, got {max(len(body) - begin, 0)}")
    if length > _MAX_HEADER_BYTES:
        raise MalformedScan(f"the header takes {length} bytes, at most {_MAX_HEADER_BYTES}")
    text = body[begin : begin + length].decode("latin-1")
    if not _LITERALS.fullmatch(text):
        raise MalformedScan(f"the header is no dictionary of literals: {short(text)}")
    try:
        with _PARSING:
            header = ast.literal_eval(text)
    except (SyntaxError, TypeError, ValueError, MemoryError, RecursionError) as error:
        raise MalformedScan(f"the header is no dictionary of literals: {short(text)}") from error
    if not isinstance(header, dict) or set(header) != {"descr", "fortran_order", "shape"}:
        raise MalformedScan(f"the header lacks descr, fortran_order or shape: {short(text)}")
    return header, begin + length


def _dtype(descr: object) -> np.dtype[Any]:
    if isinstance(descr, str):
        if not _FLOAT.fullmatch(descr):
            raise WrongDtype(f"the array holds {short(descr)}, wanted {_FLOATS}")
        return np.dtype(descr)
    if not isinstance(descr, list):
        raise MalformedScan(f"{short(descr)} describes no array")
    for field in descr:
        match field:
            case (str(), str(code)):
                pass
            case (str(), str(code), tuple(sides)) if all(type(side) is int for side in sides):
                pass
            case _:
                raise MalformedScan(f"{short(field)} describes no field")
        if not _PLAIN.fullmatch(code):
            raise WrongDtype(f"field {short(field)} is no plain number")
    try:
        dtype = npy_format.descr_to_dtype(descr)
    except (TypeError, ValueError, OverflowError, MemoryError) as error:
        raise MalformedScan(f"{short(descr)} describes no array: {error}") from error
    names = dtype.names or ()
    for axis in AXES:
        held = dtype[axis].str if axis in names else "nothing"
        if not _FLOAT.fullmatch(held):
            raise WrongDtype(f"field {axis} holds {held}, wanted {_FLOATS}; fields: {short(names)}")
    return dtype


def _shape(shape: object) -> tuple[int, ...]:
    if not isinstance(shape, tuple) or not all(type(side) is int for side in shape):
        raise MalformedScan(f"{short(shape)} is no shape")
    return shape
