"""Chunk files: raw scans of a drive in immutable HDF5 files.

One file holds m scans in packed, contiguous arrays:

    points_m    (sum of n, 3) float32   every return of every scan, one scan after the other
    scan_start  (m + 1,)      int64     where scan `row` begins and ends in points_m
    scan_index  (m,)          int64     its index in the drive

The returns are not compressed. On the 60 scans of KITTI's drive 0001 (3,651,598 returns; h5py 3.16,
two cores) gzip-1 with shuffle leaves 59 % of the bytes and lzf 74 %, but writing a scan then takes
12.8 and 9.2 ms instead of 1.8, and reading it 4.0 and 3.5 ms instead of 0.3.
"""

import hashlib
import io
from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np

from core.arrays import Float32Array, IntArray
from core.scan import Scan
from storage.errors import CorruptFile
from storage.files import publish

__all__ = ["ChunkFile", "scan_digest", "write_chunk"]

FORMAT = "tensormap-drive-chunk"
FORMAT_VERSION = 1
_RETURN_BYTES = 12


def scan_digest(points_m: Float32Array) -> str:
    """Return the SHA-256 of a scan's returns as little-endian float32, 64 hex digits.

    Two bodies of different formats that decode to the same returns in the same order are the same
    scan; timestamp and pose are facts about it, not content.
    """
    return hashlib.sha256(np.ascontiguousarray(points_m, dtype="<f4").data).hexdigest()


def write_chunk(path: Path, scans: Sequence[tuple[int, Scan]]) -> None:
    """Write `(index, scan)` pairs into a new chunk file, durably, in the order given.

    Raises:
        StorageFull: If no space or quota is left; nothing is left behind.
        StorageReadOnly: If the folder cannot be written.
    """
    # Built in memory and written at once: a full disk is then an OSError with its errno, which
    # HDF5 can lose while it closes a file.
    image = _image(scans)
    with publish(path) as part:
        part.write_bytes(image)


def _image(scans: Sequence[tuple[int, Scan]]) -> memoryview:
    starts = np.cumsum([0, *(len(scan) for _, scan in scans)], dtype="<i8")
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        file.attrs["format"] = FORMAT
        file.attrs["format_version"] = FORMAT_VERSION
        file["scan_start"] = starts
        file["scan_index"] = np.array([index for index, _ in scans], dtype="<i8")
        points = file.create_dataset("points_m", shape=(starts[-1], 3), dtype="<f4")
        for row, (_, scan) in enumerate(scans):
            points[starts[row] : starts[row + 1]] = scan.points_m
    return buffer.getbuffer()


class ChunkFile:
    """Where a chunk file has the returns of each scan; the file itself is not kept open.

    Raises:
        FileNotFoundError: If there is no such file.
        CorruptFile: If it is not a chunk file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            # Immutable, hence no lock: locking fails on read-only and some network mounts.
            with h5py.File(path, "r", locking=False) as file:
                if file.attrs["format"] != FORMAT or file.attrs["format_version"] != FORMAT_VERSION:
                    raise CorruptFile(f"{path.name} is no {FORMAT} of version {FORMAT_VERSION}")
                points, starts = file["points_m"], file["scan_start"][:]
                shape, dtype, offset = points.shape, points.dtype, points.id.get_offset()
        except FileNotFoundError:
            raise
        except (OSError, RuntimeError, KeyError, ValueError) as error:
            raise CorruptFile(f"{path.name} cannot be read: {error}") from error
        counted = starts.dtype == "<i8" and starts.size > 0
        in_order = counted and starts[0] == 0 and bool(np.all(np.diff(starts) >= 0))
        if not in_order or shape != (starts[-1], 3) or dtype != "<f4":
            raise CorruptFile(f"{path.name} does not hold its scans one after the other")
        self._starts: IntArray = starts
        self._offset = offset or 0  # none of a file without returns

    def points_m(self, row: int) -> Float32Array:
        """Read the returns of one scan, `(n, 3)` metres, and nothing of the others.

        To open the file as HDF5 for each scan of 60,000 returns would take three times as long.

        Raises:
            FileNotFoundError: If the file is gone.
            CorruptFile: If it has no such row, ends before it, or cannot be read.
        """
        if not 0 <= row < len(self._starts) - 1:
            raise CorruptFile(f"row {row} of {self._path.name}: it has {len(self._starts) - 1}")
        start, end = self._starts[row : row + 2].tolist()
        at = self._offset + start * _RETURN_BYTES
        try:
            points = np.fromfile(self._path, "<f4", count=3 * (end - start), offset=at)
        except FileNotFoundError:
            raise
        except OSError as error:
            raise CorruptFile(f"row {row} of {self._path.name} cannot be read: {error}") from error
        if len(points) != 3 * (end - start):
            raise CorruptFile(f"row {row} of {self._path.name} is cut off")
        return points.reshape(-1, 3)
