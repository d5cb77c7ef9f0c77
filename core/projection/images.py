"""Sources of images that a build reads, and the projection of a drive."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from core.arrays import Float32Array, FloatArray, IntArray, freeze, frozen
from core.errors import EmptyDrive, InvalidImage, InvalidParameters, InvalidScan
from core.progress import NO_PROGRESS, Progress
from core.projection.imager import Grid, Imager
from core.projection.probe import PROBES, Displacement, displacement_of_probe, probe_image
from core.scans.drive import Drive, scan_index_of
from core.scans.sampling import spread_evenly
from core.scans.scan import Scan


class ImageSource(Protocol):
    """Images on one grid, in the order of the map's scans; one a scan, or its D renderings.

    A build reads them twice, block by block, so that it never has all of them in memory.
    """

    @property
    def grid(self) -> Grid:
        """The lattice of every image."""

    def __len__(self) -> int:
        """Return how many images there are."""

    def read(self, start: int, stop: int) -> Float32Array:
        """Return those of scans `start` up to `stop`, `(stop - start, [D,] I, J)` float32."""


class MemoryImages:
    """Images in memory, `(n, I, J)`, or renderings, `(n, D, I, J)`."""

    def __init__(self, cells: Float32Array, grid: Grid) -> None:
        if cells.ndim not in {3, 4} or cells.shape[-2:] != grid.shape:
            raise InvalidImage(f"images have shape {cells.shape[1:]}, the grid {grid.shape}")
        self.grid = grid
        self._cells: Float32Array = frozen(cells, "float32")

    def __len__(self) -> int:
        return len(self._cells)

    def read(self, start: int, stop: int) -> Float32Array:
        """Return images `start` up to `stop`."""
        return self._cells[start:stop]


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
        """Return images `start` up to `stop`, from one or more parts."""
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
    """A scan without an image, and the reason.

    Attributes:
        scan: Its position in the drive; after `numbered` the number that the drive gives it.
        reason: Why it could not be used.
    """

    scan: int
    reason: str

    @staticmethod
    def numbered(drive: Drive, skipped: Iterable["Skipped"]) -> tuple["Skipped", ...]:
        """Return scans by their numbers, for users: a drive with gaps has others than positions."""
        index = scan_index_of(drive)
        return tuple(Skipped(int(index[one.scan]), one.reason) for one in skipped)

    @staticmethod
    def explain(drive: Drive, skipped: Sequence["Skipped"]) -> str:
        """Return the error of a drive without a usable scan, with the first reason."""
        first = Skipped.numbered(drive, skipped[:1])
        reason = "".join(f": scan {one.scan}: {one.reason}" for one in first)
        return f"drive {drive.name} has no usable scan{reason}"


class Cells(Protocol):
    """A target of images, one a row: an array in memory, or a dataset in a file."""

    def __setitem__(self, row: int, image: Float32Array) -> None:
        """Store an image."""


class ImageBuffer(Cells, Protocol):
    """A target of images that are read when all are there."""

    def filled(self, count: int) -> ImageSource:
        """Return the first `count` images."""


NewBuffer = Callable[[tuple[int, ...], Grid], ImageBuffer]
"""Makes a buffer of images of `(n, [D,] I, J)` on a grid."""


class MemoryBuffer:
    """Images of `(n, [D,] I, J)` in memory, an `ImageBuffer`."""

    def __init__(self, shape: tuple[int, ...], grid: Grid) -> None:
        self._cells, self._grid = np.empty(shape, np.float32), grid

    def __setitem__(self, row: int, image: Float32Array) -> None:
        self._cells[row] = image

    def filled(self, count: int) -> MemoryImages:
        """Return the first `count` images."""
        return MemoryImages(self._cells[:count], self._grid)


@dataclass(frozen=True, eq=False)
class Probes:
    """Disturbed scans of a map, to calibrate its answers.

    Attributes:
        rows: `(p,)` rows of their scans in the map, rising.
        displacement: `(p, 3)` of each: metres ahead of the scan and to its left, and
            relative yaw in degrees, counter-clockwise.
        images: The probes' images, one each, without renderings.
    """

    rows: IntArray
    displacement: FloatArray
    images: ImageSource

    def __post_init__(self) -> None:
        freeze(self, rows=np.int64, displacement=np.float64)
        count = len(self.images)
        if self.rows.shape != (count,) or self.displacement.shape != (count, 3):
            raise InvalidParameters(
                f"rows {self.rows.shape} and displacement {self.displacement.shape} do not fit"
                f" {count} probes"
            )
        if not np.isfinite(self.displacement).all():
            raise InvalidParameters("displacement has numbers that are not finite")
        if (np.diff(self.rows) < 1).any() or (self.rows < 0).any():
            raise InvalidParameters("rows of probes do not rise from 0 or more")

    @classmethod
    def of_drives(
        cls, drives: Sequence[tuple[IntArray, IntArray, FloatArray, ImageSource]]
    ) -> "Probes":
        """Return the probes of a map of drives, one after another.

        Args:
            drives: For each drive the positions of its mapped scans, rising, those of its probed
                ones, the displacements of the probes, and their images.
        """
        first = np.cumsum([0, *(len(scans) for scans, *_ in drives)])
        rows = [
            start + np.searchsorted(scans, probed)
            for start, (scans, probed, *_) in zip(first.tolist(), drives, strict=False)
        ]
        return cls(
            np.concatenate(rows),
            np.concatenate([displacement for _, _, displacement, _ in drives]),
            ConcatenatedImages([images for *_, images in drives]),
        )


@dataclass(frozen=True, eq=False)
class Projected:
    """The scans of a drive that have an image.

    Attributes:
        scans: `(n,)` positions of the usable scans in the drive, rising.
        returns: How many returns they have together.
        skipped: The scans that could not be used, by their positions.
        probed: `(p,)` positions of those that have a probe, rising.
        displacement: `(p, 3)` displacements of the probes, as in `Probes`.
    """

    scans: IntArray
    returns: int
    skipped: tuple[Skipped, ...]
    probed: IntArray
    displacement: FloatArray


@dataclass(frozen=True, eq=False)
class ProjectedDrive(Projected):
    """The images of a drive's usable scans, an `ImageSource`, and those of its probes."""

    images: ImageSource
    probes: ImageSource

    @property
    def grid(self) -> Grid:
        """The lattice of every image."""
        return self.images.grid

    def __len__(self) -> int:
        return len(self.images)

    def read(self, start: int, stop: int) -> Float32Array:
        """Return those of scans `start` up to `stop`."""
        return self.images.read(start, stop)


def _project_each(
    drive: Drive,
    scans: Iterable[int],
    imager: Imager,
    progress: Progress,
    rendered: "ProjectedDrive | None",
) -> Iterator[tuple[int, Scan, Float32Array] | Skipped]:
    """Read and render scans one by one; yield `Skipped` for an unusable scan."""
    known = {} if rendered is None else {int(s): row for row, s in enumerate(rendered.scans)}
    for index in scans:
        try:
            scan = drive.scan(index)
            if rendered is not None and (row := known.get(index)) is not None:
                yield index, scan, rendered.read(row, row + 1)[0]
            else:
                yield index, scan, imager.render(scan)
        except InvalidScan as error:
            yield Skipped(index, str(error))
        progress.advance()


def project_into(
    cells: Cells,
    probe_cells: Cells,
    drive: Drive,
    scans: Sequence[int],
    imager: Imager,
    progress: Progress = NO_PROGRESS,
    *,
    most_probes: int = PROBES,
    rendered: ProjectedDrive | None = None,
) -> Projected:
    """Project scans of a drive one by one into the first rows of `cells`, and probes of some.

    Args:
        cells: `(n, [D,] I, J)` for n scans.
        probe_cells: `(p, I, J)` for at most `most_probes` of them, evenly spread.
        drive: The drive.
        scans: Which of its scans, rising.
        imager: How a scan becomes an image.
        progress: Receives each scan.
        most_probes: How many probes to make, if there are so many scans.
        rendered: Scans of this drive that this imager has rendered: they are not rendered again.

    Raises:
        EmptyDrive: If not one of them is usable; the message has the first reason.
    """
    progress.start("projecting", len(scans))
    kept: list[int] = []
    probed: list[int] = []
    displacements: list[Displacement] = []
    skipped: list[Skipped] = []
    to_probe = set(spread_evenly(np.array(scans, dtype=np.int64), most_probes).tolist())
    row_of = {index: row for row, index in enumerate(scans)}
    poses = drive.poses[list(scans)]
    returns = 0
    for item in _project_each(drive, scans, imager, progress, rendered):
        if isinstance(item, Skipped):
            skipped.append(item)
            continue
        index, scan, cells[len(kept)] = item
        kept.append(index)
        returns += len(scan)
        if index not in to_probe:
            continue
        displacement = displacement_of_probe(index, imager, poses, row_of[index])
        if (probe := probe_image(scan, index, imager, displacement)) is not None:
            probe_cells[len(probed)] = probe.cells
            probed.append(index)
            displacements.append(displacement)
    if not kept:
        raise EmptyDrive(Skipped.explain(drive, skipped))
    return Projected(
        np.array(kept, dtype=np.int64),
        returns,
        tuple(skipped),
        np.array(probed, dtype=np.int64),
        np.array(displacements, dtype=np.float64).reshape(-1, 3),
    )


def project_drive(
    drive: Drive,
    scans: IntArray,
    imager: Imager,
    progress: Progress = NO_PROGRESS,
    *,
    most_probes: int = PROBES,
    rendered: ProjectedDrive | None = None,
    new_buffer: NewBuffer = MemoryBuffer,
) -> ProjectedDrive:
    """Project scans of a drive into a buffer, 43 kB an image on the paper's grid.

    `most_probes` and `rendered` are as in `project_into`. Probes, which are few, are in memory.

    Raises:
        EmptyDrive: If not one of them is usable; the message has the first reason.
    """
    buffer = new_buffer((len(scans), *imager.shape), imager.grid)
    probe_cells = np.empty((min(len(scans), most_probes), *imager.grid.shape), np.float32)
    projected = project_into(
        buffer,
        probe_cells,
        drive,
        scans.tolist(),
        imager,
        progress,
        most_probes=most_probes,
        rendered=rendered,
    )
    return ProjectedDrive(
        **vars(projected),
        images=buffer.filled(len(projected.scans)),
        probes=MemoryImages(probe_cells[: len(projected.probed)], imager.grid),
    )
