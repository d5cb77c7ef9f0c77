"""Where a build reads its images from, as often as it needs them."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from core.arrays import Float32Array, IntArray, frozen
from core.drive import Drive
from core.errors import EmptyDrive, InvalidImage, InvalidScan
from core.progress import NO_PROGRESS, Progress
from core.projection import RangeImage, Reducer, project_scan
from core.scan import Scan
from core.sensor import AngularGrid

__all__ = [
    "ConcatenatedImages",
    "ImageSource",
    "MemoryImages",
    "ProjectedDrive",
    "Skipped",
    "project_drive",
    "project_each",
]


class ImageSource(Protocol):
    """Range images on one grid, in the order of the map's scans.

    A build reads them twice, block by block, so that it never holds them all.
    """

    @property
    def grid(self) -> AngularGrid:
        """The lattice of every image."""

    def __len__(self) -> int:
        """Return how many images there are."""

    def read(self, start: int, stop: int) -> Float32Array:
        """Return images `start` up to `stop`, `(stop - start, I, J)` float32 metres."""


class MemoryImages:
    """Images held in memory, `(n, I, J)`."""

    def __init__(self, ranges_m: Float32Array, grid: AngularGrid) -> None:
        if ranges_m.ndim != 3 or ranges_m.shape[1:] != grid.shape:
            raise InvalidImage(f"images have shape {ranges_m.shape[1:]}, the grid {grid.shape}")
        self.grid = grid
        self._ranges_m: Float32Array = frozen(ranges_m, "float32")

    def __len__(self) -> int:
        return len(self._ranges_m)

    def read(self, start: int, stop: int) -> Float32Array:
        """Return images `start` up to `stop`."""
        return self._ranges_m[start:stop]


class ConcatenatedImages:
    """Several sources on one grid, one after another."""

    def __init__(self, parts: Sequence[ImageSource]) -> None:
        if not parts or any(part.grid != parts[0].grid for part in parts):
            raise InvalidImage("images can be joined on one grid only")
        self.grid = parts[0].grid
        self._parts = tuple(parts)
        self._starts = np.cumsum([0, *(len(part) for part in parts)])

    def __len__(self) -> int:
        return int(self._starts[-1])

    def read(self, start: int, stop: int) -> Float32Array:
        """Return images `start` up to `stop`, from as many parts as they lie in."""
        pieces = [
            part.read(max(0, start - first), min(len(part), stop - first))
            for part, first in zip(self._parts, self._starts.tolist(), strict=False)
            if start < first + len(part) and stop > first
        ]
        if not pieces:
            return self._parts[0].read(0, 0)
        return pieces[0] if len(pieces) == 1 else np.concatenate(pieces)


@dataclass(frozen=True)
class Skipped:
    """A scan that gave no image, and why."""

    scan: int
    reason: str

    @staticmethod
    def explain(drive: str, skipped: Sequence["Skipped"]) -> str:
        """Say that a drive has no usable scan, and why its first one is none."""
        reason = f": scan {skipped[0].scan}: {skipped[0].reason}" if skipped else ""
        return f"drive {drive} has no usable scan{reason}"


@dataclass(frozen=True, eq=False)
class ProjectedDrive:
    """The images of a drive's usable scans.

    Attributes:
        images: One for each usable scan.
        scans: `(n,)` their positions in the drive, rising.
        returns: How many returns they hold together.
        skipped: The scans that could not be used.
    """

    images: ImageSource
    scans: IntArray
    returns: int
    skipped: tuple[Skipped, ...]


def project_each(
    drive: Drive,
    scans: Iterable[int],
    grid: AngularGrid,
    reducer: Reducer,
    progress: Progress = NO_PROGRESS,
) -> Iterator[tuple[int, Scan, RangeImage] | Skipped]:
    """Read and project scans one by one; one that cannot be used is told, the rest goes on."""
    for index in scans:
        try:
            scan = drive.scan(index)
            yield index, scan, project_scan(scan, grid, reducer)
        except InvalidScan as error:
            yield Skipped(index, str(error))
        progress.advance()


def project_drive(
    drive: Drive,
    scans: IntArray,
    grid: AngularGrid,
    reducer: Reducer,
    progress: Progress = NO_PROGRESS,
) -> ProjectedDrive:
    """Project scans of a drive into memory, 43 kB each on the paper's grid.

    Raises:
        EmptyDrive: If not one of them is usable; the message gives the first reason.
    """
    progress.start("projecting", len(scans))
    ranges_m = np.empty((len(scans), *grid.shape), np.float32)
    kept: list[int] = []
    skipped: list[Skipped] = []
    returns = 0
    for item in project_each(drive, scans.tolist(), grid, reducer, progress):
        if isinstance(item, Skipped):
            skipped.append(item)
            continue
        index, scan, image = item
        ranges_m[len(kept)] = image.ranges_m
        kept.append(index)
        returns += len(scan)
    if not kept:
        raise EmptyDrive(Skipped.explain(drive.name, skipped))
    return ProjectedDrive(
        MemoryImages(ranges_m[: len(kept)], grid),
        np.array(kept, dtype=np.int64),
        returns,
        tuple(skipped),
    )
