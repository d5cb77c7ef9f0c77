"""Array aliases, and how arrays are made read-only."""

from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
Complex64Array = NDArray[np.complex64]
ComplexArray = NDArray[np.complex128]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


def frozen(values: ArrayLike, dtype: DTypeLike) -> NDArray[Any]:
    """Return `values` as a read-only, C-contiguous array of `dtype`.

    An array that already is all of that is returned as it is; the caller's own writable array is
    viewed or copied, and stays writable. A number beyond `dtype` becomes infinite, which the types
    reject themselves.
    """
    if isinstance(values, np.ndarray) and values.dtype == dtype:
        array = np.ascontiguousarray(values)
    else:
        with np.errstate(over="ignore"):
            array = np.ascontiguousarray(values, dtype=dtype)
    if array.flags.writeable:
        array = array.view()
        array.flags.writeable = False
    return array


def freeze(owner: object, **dtypes: DTypeLike) -> None:
    """Replace arrays of a frozen dataclass, by name, with read-only ones of these dtypes."""
    for name, dtype in dtypes.items():
        object.__setattr__(owner, name, frozen(getattr(owner, name), dtype))


def arrays_of(owner: object) -> dict[str, NDArray[Any]]:
    """Return the attributes of a dataclass that are arrays, by name."""
    assert is_dataclass(owner)  # noqa: S101 - for mypy
    values = {field.name: getattr(owner, field.name) for field in fields(owner)}
    return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
