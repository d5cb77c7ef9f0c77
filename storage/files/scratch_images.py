"""Images in files of the temporary folder, for as long as a command needs them."""

import math
import tempfile
from contextlib import ExitStack
from io import FileIO

import numpy as np

from core.arrays import Float32Array
from core.projection.imager import Grid
from storage.closing import Closing
from storage.errors import StorageFailure, StorageFull
from storage.files.files import named_disk_errors


class ScratchImages(Closing):
    """Makes room for images in files without a name, as `core.projection.images.Rooms`.

    They are not checked as files that stay are: the process that wrote them reads them.
    """

    def __init__(self) -> None:
        self._files = ExitStack()

    def __call__(self, shape: tuple[int, ...], grid: Grid) -> "ScratchRoom":
        """Return room for images of `(n, [D,] I, J)`."""
        file = tempfile.TemporaryFile(prefix="tensormap-", buffering=0)  # noqa: SIM115 - by `close`
        return ScratchRoom(self._files.enter_context(file), shape[1:], grid)

    def close(self) -> None:
        """Remove the files."""
        self._files.close()


class ScratchRoom:
    """Images of one shape in an open file, one after another."""

    def __init__(self, file: FileIO, shape: tuple[int, ...], grid: Grid, count: int = 0) -> None:
        self.grid = grid
        self._file, self._shape, self._count = file, shape, count
        self._image_bytes = 4 * math.prod(shape)

    def __setitem__(self, row: int, image: Float32Array) -> None:
        left = _bytes_of(np.ascontiguousarray(image, np.float32))
        try:
            with named_disk_errors():
                self._file.seek(row * self._image_bytes)
                while left:
                    left = left[self._file.write(left) :]
        except StorageFull as error:
            raise StorageFull(
                f"no space is left in {tempfile.gettempdir()} for the images: free some, or set"
                " TMPDIR to another folder"
            ) from error

    def filled(self, count: int) -> "ScratchRoom":
        """Return the first `count` images."""
        return ScratchRoom(self._file, self._shape, self.grid, count)

    def __len__(self) -> int:
        return self._count

    def read(self, start: int, stop: int) -> Float32Array:
        """Return images `start` up to `stop`."""
        start, stop, _ = slice(start, stop).indices(self._count)
        images = np.empty((max(0, stop - start), *self._shape), np.float32)
        left = _bytes_of(images)
        with named_disk_errors():
            self._file.seek(start * self._image_bytes)
            while left:
                if not (count := self._file.readinto(left)):
                    raise StorageFailure("the file of the images became shorter")
                left = left[count:]
        return images


def _bytes_of(images: Float32Array) -> memoryview:
    return images.reshape(-1).view(np.uint8).data
