"""The C++ example, compiled here and called from Python."""

import ctypes
import shutil
import subprocess
from functools import cached_property
from pathlib import Path

import numpy as np

from core.arrays import Float32Array, IntArray

EXAMPLES = Path(__file__).parents[2] / "examples"
COMPILER = shutil.which("c++") or shutil.which("g++")
WITHOUT = "a C++ compiler is needed: g++"
_FLAGS = ("-std=c++17", "-ffp-contract=off", "-Wall", "-Wextra", "-Wpedantic", "-Werror")
FAST = ("-O3", "-march=native", "-fno-math-errno")  # as on a vehicle
_MOST_BYTES = 1 << 16


def compiled(source: str, to: Path, *flags: str) -> Path:
    """Compile a program of `examples/cpp` and return it."""
    assert COMPILER is not None, WITHOUT
    command = [COMPILER, *_FLAGS, *flags, "-o", str(to), str(EXAMPLES / "cpp" / source)]
    subprocess.run(command, check=True, capture_output=True, text=True)
    return to


class CppSignatures:
    """Signatures by `examples/cpp`, with one basis.

    Args:
        basis: As JSON, of the service.
        folder: For the library.
    """

    def __init__(self, basis: str, folder: Path | str) -> None:
        flags = (*FAST, "-shared", "-fPIC")
        path = compiled("c_interface.cpp", Path(folder, "libtensormap.so"), *flags)
        self._library = ctypes.CDLL(str(path))
        self._library.tensormap_basis.restype = ctypes.c_void_p
        self._library.tensormap_cells.restype = ctypes.c_ssize_t
        self._json = basis.encode()
        self._body = (ctypes.c_uint8 * _MOST_BYTES)()

    @cached_property
    def _basis(self) -> ctypes.c_void_p:
        basis = ctypes.c_void_p(self._library.tensormap_basis(self._json))
        assert basis, "the basis cannot be read"
        return basis

    def query(self, rows: Float32Array, sensor_height_m: float) -> bytes:
        """Return the packed signature of `(n, 3)` rows or longer ones, empty if there is none."""
        height_m = ctypes.c_double(sensor_height_m)
        count = self._library.tensormap_query(
            self._basis, *_scan(rows), height_m, self._body, _size(_MOST_BYTES)
        )
        assert count >= -1
        return bytes(self._body[: max(count, 0)])

    def cells(self, rows: Float32Array, sensor_height_m: float) -> tuple[Float32Array, IntArray]:
        """Return the levelled returns, `(n, 3)`, and their flat cells, -1 outside of the grid."""
        level_m = np.empty((len(rows), 3), np.float32)
        cells = np.empty(len(rows), np.int32)
        count = self._library.tensormap_cells(
            self._basis,
            *_scan(rows),
            ctypes.c_double(sensor_height_m),
            ctypes.c_void_p(level_m.ctypes.data),
            ctypes.c_void_p(cells.ctypes.data),
        )
        if count < 0:
            raise ValueError(f"the sensor's height is {sensor_height_m} m")
        return level_m[:count], cells[:count].astype(np.int64)


def _scan(rows: Float32Array) -> tuple[ctypes.c_void_p, ctypes.c_size_t, ctypes.c_size_t]:
    assert rows.dtype == np.float32
    assert rows.flags.c_contiguous
    return ctypes.c_void_p(rows.ctypes.data), _size(len(rows)), _size(rows.shape[1])


def _size(value: int) -> ctypes.c_size_t:
    return ctypes.c_size_t(value)
