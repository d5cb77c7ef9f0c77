"""A drive's images in one HDF5 file, so that builds read raw returns only once."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from core.encodings.grams import drive_gram
from core.errors import EmptyDrive
from core.progress import NO_PROGRESS, Progress
from core.projection.imager import Grid, Imager
from core.projection.images import ImageSource, Skipped, project_into
from core.projection.probe import PROBES
from core.revision import content_digest
from core.scans.drive import Drive
from core.scans.sampling import spread_evenly
from core.scans.stands import first_of_stands
from storage.closing import Closing
from storage.durable_file import reading_back
from storage.errors import CorruptFile, CorruptImages
from storage.files.claims import writing_in
from storage.files.files import named_disk_errors, publish
from storage.files.free_space import OF_SCANS
from storage.files.json_text import parse_json
from storage.hdf5 import Dataset, FileSource, Hdf5File
from storage.hdf5.writer import FileWriter, hdf5_on_disk

PROJECTION_VERSION = 1
"""Incremented whenever the code makes other images of the same scans, or skips others."""

PROBE_VERSION = 2
"""Incremented whenever the code makes other probes of the same scans; images stay the same."""

_DETAIL_GRAM, _COUNTED = "detail_gram", "counted"
_OCCUPIED, _PROBES_OCCUPIED = "occupied", "probes_occupied"  # cells of each that are not 0
_BLOCK = 8  # images in an HDF5 chunk: 340 kB on the paper's grid
_MOST_SKIPPED_BYTES = 2**26  # some 100 bytes a scan


class ImageFile(Closing):
    """Images of a drive's usable scans, read block by block; an `ImageSource`.

    Attributes:
        grid: The grid of every image.
        scans: `(n,)` position of each image's scan in the drive.
        skipped: The scans that could not be used.
        returns: Number of returns of the usable scans.
        probes: Images of disturbed scans, `None` in a file of another version of the probes.
        probed: `(p,)` position of each probe's scan in the drive.
        displacement: `(p, 3)` that of each probe, as in `core.projection.images.Probes`.
    """

    def __init__(self, path: Path, imager: Imager) -> None:
        self.grid: Grid = imager.grid
        self._name = path.name
        self._file: Hdf5File | None = None
        try:
            self._file = Hdf5File(FileSource(path))
            self._read_facts(self._file, imager)
        except (CorruptFile, FileNotFoundError) as error:
            self.close()
            # The text of an error of the system has the path, which a client need not know.
            why = error.strerror if isinstance(error, OSError) else error
            raise CorruptImages(f"{path.name} holds no images: {why}") from error

    def _read_facts(self, file: Hdf5File, imager: Imager) -> None:
        attributes = file.attributes
        self.scans: IntArray = valid_numbers(_typed(file, "scans", "<i8", 1).read())
        images = _typed(file, "images", "<f4", 1 + len(imager.shape))
        self.read = _Stored(images, self.grid, self._name, _occupied(file, _OCCUPIED)).read
        self.returns = attributes.whole("returns")
        self.skipped = _skipped(attributes.text("skipped", _MOST_SKIPPED_BYTES))
        if images.shape != (len(self.scans), *imager.shape):
            raise CorruptFile(f"they have shape {images.shape}")
        self.probes: ImageSource | None = None
        self.probed: IntArray = np.empty(0, np.int64)
        self.displacement: FloatArray = np.empty((0, 3))
        if "probe_version" not in attributes:
            return
        if attributes.whole("probe_version") != PROBE_VERSION:
            return
        probes = _typed(file, "probes", "<f4", 1 + len(self.grid.shape))
        self.probed = valid_numbers(_typed(file, "probed", "<i8", 1).read())
        self.displacement = valid_numbers(_typed(file, "standing", "<f8", 2).read())
        occupied = _occupied(file, _PROBES_OCCUPIED)
        self.probes = _Stored(probes, self.grid, self._name, occupied)
        if probes.shape != (len(self.probed), *self.grid.shape):
            raise CorruptFile(f"probes have shape {probes.shape}")
        if self.displacement.shape != (len(self.probed), 3):
            raise CorruptFile(f"standing has shape {self.displacement.shape}")

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()

    def __len__(self) -> int:
        return len(self.scans)

    def detail_gram(self, counted: BoolArray) -> FloatArray:
        """Return the Gram matrix that a radial basis is fitted to, `(I, I)`.

        Files with renderings hold it. It is computed for files of versions that did not store it,
        and where others of their scans count.

        Args:
            counted: `(n,)` which of the images count, see `drive_gram`.

        Raises:
            CorruptImages: If it cannot be read, or its checksum does not fit.
        """
        if self._file is not None and _DETAIL_GRAM in self._file.names:
            try:
                is_of_these = np.array_equal(self._counted(self._file), np.flatnonzero(counted))
                gram: FloatArray = valid_numbers(_typed(self._file, _DETAIL_GRAM, "<f8", 2).read())
                if gram.shape != (self.grid.rows, self.grid.rows):
                    raise CorruptFile(f"{_DETAIL_GRAM} has shape {gram.shape}")
            except CorruptFile as error:
                raise CorruptImages(f"{self._name} cannot be read: {error}") from error
            if is_of_these:
                return gram
        return drive_gram(self, 0, counted)

    def _counted(self, file: Hdf5File) -> IntArray:
        """Return the images that the sum is of: all in files of versions that do not say."""
        if _COUNTED not in file.names:
            return np.arange(len(self))
        return np.asarray(_typed(file, _COUNTED, "<i8", 1).read())


class _Stored:
    """Images in an open file, read block by block; an `ImageSource`.

    The Fletcher checksum of zeros is 0: how many cells are not 0 shows a block that is gone.
    """

    def __init__(
        self, images: Dataset, grid: Grid, name: str, occupied: IntArray | None = None
    ) -> None:
        self.grid = grid
        self._images, self._name = images, name
        self._occupied = occupied  # not in files of versions that did not store it

    def __len__(self) -> int:
        return self._images.shape[0]

    def read(self, start: int, stop: int) -> Float32Array:
        """Return those of scans `start` up to `stop`, `(stop - start, [D,] I, J)`.

        Raises:
            CorruptImages: If they cannot be read, or their checksum does not fit.
        """
        try:
            block: Float32Array = valid_numbers(self._images.rows(start, stop))
            if self._occupied is not None and not np.array_equal(
                _occupied_cells(block), self._occupied[start:stop]
            ):
                raise CorruptFile("they have other numbers of occupied cells than when written")
        except CorruptFile as error:
            raise CorruptImages(f"{self._name} cannot be read: {error}") from error
        return block


def _occupied_cells(images: Float32Array) -> IntArray:
    axes = tuple(range(1, images.ndim))
    return np.asarray(np.count_nonzero(images, axis=axes), np.int64)


def _occupied(file: Hdf5File, name: str) -> IntArray | None:
    return np.asarray(_typed(file, name, "<i8", 1).read()) if name in file.names else None


def _typed(file: Hdf5File, name: str, dtype: str, axes: int) -> Dataset:
    dataset = file.dataset(name)
    if dataset.dtype != dtype or len(dataset.shape) != axes:
        raise CorruptFile(f"{name} has shape {dataset.shape} of {dataset.dtype}, wanted {dtype}")
    return dataset


def valid_numbers(numbers: NDArray[Any]) -> NDArray[Any]:
    """Return numbers of a file of images after a check of their range.

    A Fletcher checksum does not detect 0 changed to 0xFFFF, and images are mostly zeros, which so
    become NaN, subnormal numbers or negative positions.

    Raises:
        CorruptFile: If one is not finite, or subnormal, or a position below 0.
    """
    if numbers.dtype.kind == "i":
        if (numbers < 0).any():
            raise CorruptFile("a position in it is negative")
        return numbers
    size = np.abs(numbers)
    if not np.isfinite(size).all() or ((size > 0.0) & (size < np.finfo(size.dtype).tiny)).any():
        raise CorruptFile("a number in it was never written")
    return numbers


def _skipped(text: str) -> tuple[Skipped, ...]:
    """Return the scans that could not be used, from pairs of position and reason."""
    items = parse_json(text, "its attribute skipped")
    if not isinstance(items, list):
        raise CorruptFile("its attribute skipped is no list")
    skipped = []
    for item in items:
        match item:
            case [int(scan), str(reason)]:
                skipped.append(Skipped(scan, reason))
            case _:
                raise CorruptFile(f"its attribute skipped holds {item!r:.80}")
    return tuple(skipped)


IMAGE_FILE_NAME = r"[a-z]{1,20}-[0-9a-f]{16}-[0-9a-f]{32}\.h5"
"""All that `image_file_name` returns: no other file beside them is read."""


def is_image_file_name(name: str) -> bool:
    """Return whether a file of this name may be one of images."""
    return re.fullmatch(IMAGE_FILE_NAME, name) is not None


def image_file_name(imager: Imager, scans_digest: str) -> str:
    """Return the name of the file of a drive's images.

    It depends on the scans' content, the grid, the reducer and `PROJECTION_VERSION`: a file of that
    name is out of date only if the code was changed without incrementing that.
    """
    projection = content_digest({}, {"version": PROJECTION_VERSION, **imager.as_attributes()})
    return f"{imager.reducer}-{projection[:16]}-{scans_digest[:32]}.h5"


def remove_other_versions(path: Path, newest: Path) -> None:
    """Remove the images of the same projection of a drive as it was earlier.

    A process that reads one can read it to its end.

    Args:
        path: The images that were just made; they stay.
        newest: The images of the drive as it is now; they stay, if another build made them.
    """
    projection, _, _ = path.stem.rpartition("-")
    for other in path.parent.glob(f"{projection}-*.h5"):
        if other not in {path, newest}:
            other.unlink(missing_ok=True)


def write_image_file(
    path: Path, drive: Drive, imager: Imager, progress: Progress = NO_PROGRESS
) -> None:
    """Read and project every scan of a drive, and publish the images and probes at `path`.

    Raises:
        EmptyDrive: If not one scan is usable; the message gives the first reason.
        StorageFull: If no space is left; nothing is left behind.
    """
    if not len(drive):
        raise EmptyDrive(Skipped.explain(drive, ()))
    with named_disk_errors(), writing_in(path.parent), publish(path, synced=True) as part:
        with hdf5_on_disk(part) as writer:
            _write(writer, drive, imager, progress)
        OF_SCANS.require_kept(part.parent, "the images of a drive")
        with reading_back():
            ImageFile(part, imager).close()


def _write(writer: FileWriter, drive: Drive, imager: Imager, progress: Progress) -> None:
    scans = np.arange(len(drive))
    renderings = imager.shape[0] if imager.lateral_renderings_m is not None else 1
    block = min(max(1, _BLOCK // renderings), len(scans))
    images = writer.add_rows("images", "<f4", len(scans), (block, *imager.shape))
    most_probes = len(spread_evenly(scans, PROBES))
    probes = writer.add_rows("probes", "<f4", most_probes, (1, *imager.grid.shape))
    result = project_into(images, probes, drive, range(len(scans)), imager, progress)
    images.end()
    probes.end()
    for name, rows in ((_OCCUPIED, images), (_PROBES_OCCUPIED, probes)):
        with rows.readable() as written:
            starts = range(0, written.shape[0], _BLOCK)
            counts = [_occupied_cells(written.rows(at, at + _BLOCK)) for at in starts]
        writer.add(name, np.concatenate([np.empty(0, np.int64), *counts]).astype("<i8"))
    writer.add("probed", result.probed.astype("<i8"))
    writer.add("standing", result.displacement.astype("<f8"))
    writer.add("scans", result.scans.astype("<i8"))
    if imager.lateral_renderings_m is not None:
        with images.readable() as written:
            counted = first_of_stands(drive.poses[result.scans])
            gram = drive_gram(_Stored(written, imager.grid, "images"), 0, counted)
        writer.add(_DETAIL_GRAM, gram.astype("<f8"))
        writer.add(_COUNTED, np.flatnonzero(counted).astype("<i8"))
    writer.add_attributes(
        {
            "probe_version": PROBE_VERSION,
            "returns": result.returns,
            "skipped": json.dumps([[item.scan, item.reason] for item in result.skipped]),
        }
    )
