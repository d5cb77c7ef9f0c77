"""Images in a file of the temporary folder, for as long as a command needs them."""

import math
import os
import tempfile
import weakref

import numpy as np

from core.arrays import Float32Array
from core.projection.imager import Grid
from storage.errors import StorageFailure, StorageFull
from storage.files.files import named_disk_errors


class FileBuffer:
    """Images of `(n, [D,] I, J)` in a file without a name, a `core.projection.images.ImageBuffer`.

    The file is gone with this object. It is not checked as files that stay are: the process that
    wrote it reads it.
    """

    def __init__(self, shape: tuple[int, ...], grid: Grid) -> None:
        self.grid = grid
        self._shape, self._count = shape[1:], 0
        self._image_bytes = 4 * math.prod(self._shape)
        self._file = tempfile.TemporaryFile(prefix="tensormap-", buffering=0)  # noqa: SIM115 - below
        weakref.finalize(self, self._file.close)

    def __setitem__(self, row: int, image: Float32Array) -> None:
        left, at = _bytes_of(np.ascontiguousarray(image, np.float32)), row * self._image_bytes
        try:
            with named_disk_errors():
                while left:
                    count = os.pwrite(self._file.fileno(), left, at)
                    left, at = left[count:], at + count
        except StorageFull as error:
            raise StorageFull(
                f"no space is left in {tempfile.gettempdir()} for the images: free some, or set"
                " TMPDIR to another folder"
            ) from error

    def filled(self, count: int) -> "FileBuffer":
        """Return the first `count` images."""
        self._count = count
        return self

    def __len__(self) -> int:
        return self._count

    def read(self, start: int, stop: int) -> Float32Array:
        """Return images `start` up to `stop`."""
        start, stop, _ = slice(start, stop).indices(self._count)
        images = np.empty((max(0, stop - start), *self._shape), np.float32)
        left, at = _bytes_of(images), start * self._image_bytes
        with named_disk_errors():
            while left:
                if not (count := os.preadv(self._file.fileno(), [left], at)):
                    raise StorageFailure("the file of the images became shorter")
                left, at = left[count:], at + count
        return images


def _bytes_of(images: Float32Array) -> memoryview:
    return images.reshape(-1).view(np.uint8).data
