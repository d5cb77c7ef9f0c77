"""Array aliases and the one way the product freezes an array."""

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

    An array that already is all of that is returned as it is; the caller's own
    writable array is never made read-only under its hands, but viewed or copied. A number
    beyond `dtype` becomes infinite; the types refuse that themselves.
    """
    with np.errstate(over="ignore"):
        array = np.ascontiguousarray(values, dtype=dtype)
    if array.flags.writeable:
        array = array.view()
        array.flags.writeable = False
    return array
