"""A drive's images in one HDF5 file, so that a build reads raw returns once."""

import json
from pathlib import Path
from typing import Self

import h5py
import numpy as np

from core.arrays import Float32Array, FloatArray, IntArray
from core.drive import Drive
from core.errors import EmptyDrive
from core.grams import drive_gram
from core.imager import Grid, Imager
from core.images import ImageSource, Skipped, project_into
from core.progress import NO_PROGRESS, Progress
from core.revision import content_digest
from core.trust.probe import probed_among
from storage.errors import CorruptImages
from storage.files import publish

__all__ = [
    "PROBE_VERSION",
    "PROJECTION_VERSION",
    "ImageFile",
    "image_file_name",
    "remove_other_versions",
    "write_image_file",
]

PROJECTION_VERSION = 1
"""Counted up whenever the code makes other images of the same scans, or skips others."""

PROBE_VERSION = 2
"""Counted up whenever the code makes other probes of the same scans; images stay what they are."""

_DETAIL_GRAM = "detail_gram"
_BLOCK = 8  # images in an HDF5 chunk: 340 kB on the paper's grid, inside h5py's 1 MB cache


class ImageFile:
    """Images of a drive's usable scans, read block by block; a `core.images.ImageSource`.

    Attributes:
        grid: The lattice of every image.
        scans: `(n,)` position of each image's scan in the drive.
        skipped: The scans that could not be used.
        returns: How many returns the usable scans hold together.
        probes: Images of disturbed scans, `None` in a file of another version of the probes.
        probed: `(p,)` position of each probe's scan in the drive.
        standing: `(p, 3)` where each probe stands, as in `core.images.Probes`.
    """

    def __init__(self, path: Path, imager: Imager) -> None:
        self.grid: Grid = imager.grid
        self._name = path.name
        try:
            self._file = h5py.File(path, "r", locking=False)
        except OSError as error:
            raise CorruptImages(f"{path.name} holds no images: {error}") from error
        try:
            self._images: h5py.Dataset = self._file["images"]
            self.scans: IntArray = self._file["scans"][()]
            self.returns = int(self._file.attrs["returns"])
            self.skipped = tuple(Skipped(*item) for item in json.loads(self._file.attrs["skipped"]))
            if self._images.shape != (len(self.scans), *imager.shape):
                raise ValueError(f"they have shape {self._images.shape}")
            self.probes: ImageSource | None = None
            self.probed: IntArray = np.empty(0, np.int64)
            self.standing: FloatArray = np.empty((0, 3))
            if self._file.attrs.get("probe_version") == PROBE_VERSION:
                self.probed = self._file["probed"][()]
                self.standing = self._file["standing"][()]
                self.probes = _Stored(self._file["probes"], self.grid, path.name)
                if self._file["probes"].shape != (len(self.probed), *self.grid.shape):
                    raise ValueError(f"probes have shape {self._file['probes'].shape}")
                if self.standing.shape != (len(self.probed), 3):
                    raise ValueError(f"standing has shape {self.standing.shape}")
        except (AttributeError, KeyError, OSError, RuntimeError, TypeError, ValueError) as error:
            self._file.close()
            raise CorruptImages(f"{path.name} holds no images: {error}") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let the file go."""
        self._file.close()

    def __len__(self) -> int:
        return len(self.scans)

    def read(self, start: int, stop: int) -> Float32Array:
        """Return those of scans `start` up to `stop`, `(stop - start, [D,] I, J)`.

        Raises:
            CorruptImages: If they cannot be read, or their checksum does not fit.
        """
        return _read(self._images, start, stop, self._name)

    def detail_gram(self, progress: Progress = NO_PROGRESS) -> FloatArray:
        """Return what a radial basis is fitted to, `(I, I)`; reads no image if it is kept.

        Files of renderings keep it beside them; in one that was written before they did, it is
        summed when it is asked for.

        Raises:
            CorruptImages: If it cannot be read, or its checksum does not fit.
        """
        try:
            if _DETAIL_GRAM in self._file:
                kept: FloatArray = self._file[_DETAIL_GRAM][()]
                if kept.shape != (self.grid.rows, self.grid.rows):
                    raise ValueError(f"{_DETAIL_GRAM} has shape {kept.shape}")
                return kept
        except (AttributeError, OSError, RuntimeError, TypeError, ValueError) as error:
            raise CorruptImages(f"{self._name} cannot be read: {error}") from error
        return drive_gram(self, 0, len(self), progress)


class _Stored:
    """Images in an open file, read block by block; a `core.images.ImageSource`."""

    def __init__(self, images: h5py.Dataset, grid: Grid, name: str) -> None:
        self.grid = grid
        self._images, self._name = images, name

    def __len__(self) -> int:
        return len(self._images)

    def read(self, start: int, stop: int) -> Float32Array:
        return _read(self._images, start, stop, self._name)


def _read(images: h5py.Dataset, start: int, stop: int, name: str) -> Float32Array:
    try:
        block: Float32Array = images[start:stop]
    except (OSError, RuntimeError) as error:
        raise CorruptImages(f"{name} cannot be read: {error}") from error
    return block


def image_file_name(imager: Imager, scans_digest: str) -> str:
    """Return the name under which a drive's images are kept.

    It tells the scans' content, the grid, the reducer and `PROJECTION_VERSION`: a file of that name
    is out of date only if the code was changed without counting that up.
    """
    projection = content_digest({}, {"version": PROJECTION_VERSION, **imager.as_attributes()})
    return f"{imager.reducer}-{projection[:16]}-{scans_digest[:32]}.h5"


def remove_other_versions(path: Path) -> None:
    """Remove the images of the same projection that the drive had with fewer scans.

    Whoever reads one goes on to its end.
    """
    projection, _, _ = path.stem.rpartition("-")
    for other in path.parent.glob(f"{projection}-*.h5"):
        if other != path:
            other.unlink(missing_ok=True)


def write_image_file(
    path: Path,
    drive: Drive,
    imager: Imager,
    progress: Progress = NO_PROGRESS,
) -> None:
    """Read and project every scan of a drive, and publish the images and probes at `path`.

    Raises:
        EmptyDrive: If not one scan is usable; the message gives the first reason.
        StorageFull: If no space is left; nothing is left behind.
    """
    if not len(drive):
        raise EmptyDrive(Skipped.explain(drive.name, ()))
    renderings = imager.shape[0] if imager.lateral_renderings_m is not None else 1
    block = max(1, _BLOCK // renderings)
    with publish(path) as part, h5py.File(part, "x", libver="v110") as file:
        images = file.create_dataset(
            "images",
            shape=(len(drive), *imager.shape),
            maxshape=(len(drive), *imager.shape),
            chunks=(min(block, len(drive)), *imager.shape),
            dtype=np.dtype("<f4"),
            fletcher32=True,  # HDF5 then refuses to read a block that has changed
        )
        probe_shape = (len(probed_among(np.arange(len(drive)))), *imager.grid.shape)
        probes = file.create_dataset(
            "probes",
            shape=probe_shape,
            maxshape=probe_shape,
            chunks=(1, *imager.grid.shape),
            dtype=np.dtype("<f4"),
            fletcher32=True,
        )
        told = project_into(images, probes, drive, range(len(drive)), imager, progress)
        images.resize(len(told.scans), axis=0)
        probes.resize(len(told.probed), axis=0)
        checked = bool(told.probed.size)  # HDF5 keeps no checksum of nothing
        file.create_dataset("probed", data=told.probed.astype("<i8"), fletcher32=checked)
        file.create_dataset("standing", data=told.standing.astype("<f8"), fletcher32=checked)
        file.attrs["probe_version"] = PROBE_VERSION
        file.create_dataset("scans", data=told.scans.astype("<i8"), fletcher32=True)
        if imager.lateral_renderings_m is not None:
            written = _Stored(images, imager.grid, path.name)
            gram = drive_gram(written, 0, len(written))
            file.create_dataset(_DETAIL_GRAM, data=gram.astype("<f8"), fletcher32=True)
        file.attrs["returns"] = told.returns
        file.attrs["skipped"] = json.dumps([[item.scan, item.reason] for item in told.skipped])
