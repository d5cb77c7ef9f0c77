"""A file that the catalog names, and whether it holds what was stored."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path, PurePosixPath

from storage.errors import CorruptFile
from storage.files.basis_file import read_basis
from storage.files.drive_chunks import ChunkFile, scan_digest
from storage.files.image_file import valid_numbers
from storage.files.map_file import read_map
from storage.hdf5 import FileSource, Hdf5File

_ROWS = 64  # of images, some megabytes
_MOST_RANGES = 10  # of scans, in words


@dataclass(frozen=True)
class StoredFile:
    """A file of the store.

    Attributes:
        path: The file's path under the data directory.
        scans: Digests of its scans in the catalog, by row.
        indices: Indices of these scans in their drive, by row.
        revision: Digest of the revision that it holds, `None` if it holds none.
        basis: Digest of the shared basis that it holds, `None` likewise.
    """

    path: str
    scans: Mapping[int, str] = field(default_factory=dict)
    indices: Mapping[int, int] = field(default_factory=dict)
    revision: str | None = None
    basis: str | None = None

    @property
    def name(self) -> str:
        """Its name in its folder."""
        return PurePosixPath(self.path).name

    @property
    def kind(self) -> str:
        """Its kind, the name of its folder: `revisions`, `chunks`, `images` or `bases`."""
        return PurePosixPath(self.path).parent.name

    @property
    def map_id(self) -> str:
        """The map that it belongs to, if it is no basis."""
        return PurePosixPath(self.path).parts[1]

    @property
    def drive_id(self) -> str:
        """The drive that it belongs to, if it is no revision or basis."""
        return PurePosixPath(self.path).parts[3]

    def described(self, slugs: Mapping[str, str], good_rows: Collection[int] = ()) -> str:
        """Return a description for users: map and drive with the scans, or map and revision.

        Args:
            slugs: Slugs of maps and drives, by id.
            good_rows: Rows of a file of scans to leave out.

        Examples:
            >>> file = StoredFile("maps/a1/drives/b2/chunks/c3.h5", indices={0: 7, 1: 8, 2: 10})
            >>> file.described({"a1": "campus", "b2": "monday"})
            'map campus, drive monday, scans 7-8, 10'
        """
        if self.basis is not None:
            return f"shared basis {self.basis[:12]}"
        of_map = f"map {slugs.get(self.map_id, self.map_id)}"
        if self.revision is not None:
            return f"{of_map}, revision {self.revision[:12]}"
        of_drive = f"{of_map}, drive {slugs.get(self.drive_id, self.drive_id)}"
        if self.kind == "images":
            return f"{of_drive}, cached images"
        return f"{of_drive}, {_scans(i for row, i in self.indices.items() if row not in good_rows)}"


@dataclass(frozen=True)
class Fault:
    """The fault of a file.

    Attributes:
        what: A description.
        certain: Whether its content is at fault; else it could not be read to its end, and may be
            good.
        good_rows: Rows of a file of scans that are as they were put.
    """

    what: str
    certain: bool = True
    good_rows: tuple[int, ...] = ()


def fault_of(path: Path, file: StoredFile) -> Fault | None:
    """Read a file to its end; return its fault, `None` if it is what was stored.

    A failing disk may block this forever: `storage.files.checker` calls it in its own process.

    Args:
        path: The file's path.
        file: What it should hold.

    Raises:
        FileNotFoundError: If it is gone.
        OSError: If it cannot be read.
    """
    try:
        if file.kind == "images":
            _read_images(path)
        elif file.basis is not None:
            read_basis(path, file.basis)
        elif file.revision is not None:
            found = read_map(path).revision
            if found != file.revision:
                return Fault(f"it holds revision {found}, not {file.revision}")
        else:
            return _fault_of_scans(ChunkFile(path), file.scans)
    except CorruptFile as error:
        return Fault(str(error), certain=not _is_of_the_disk(error))
    return None


def _fault_of_scans(chunk: ChunkFile, scans: Mapping[int, str]) -> Fault | None:
    good, wrong, certain = [], [], True
    for row, digest in sorted(scans.items()):
        try:
            if scan_digest(chunk.points_m(row)) == digest:
                good.append(row)
            else:
                wrong.append(f"row {row} is not the scan that was put")
        except CorruptFile as error:
            wrong.append(str(error))
            certain = certain and not _is_of_the_disk(error)
    if not wrong:
        return None
    more = f"; {len(wrong)} of {len(scans)} rows are damaged" if len(wrong) > 1 else ""
    return Fault(wrong[0] + more, certain, tuple(good))


def _scans(indices: Iterable[int]) -> str:
    """Return scans as ranges of their indices, the first ranges only if there are many."""
    # Within a range without a gap, an index minus its rank is constant.
    ranked = enumerate(sorted(indices))
    islands = [[i for _, i in of] for _, of in groupby(ranked, lambda pair: pair[1] - pair[0])]
    shown = [f"{of[0]}-{of[-1]}" if len(of) > 1 else f"{of[0]}" for of in islands[:_MOST_RANGES]]
    more = sum(map(len, islands[_MOST_RANGES:]))
    one = len(islands) == 1 and len(islands[0]) == 1
    return f"scan{'' if one else 's'} {', '.join(shown)}" + (f" and {more} more" if more else "")


def _is_of_the_disk(error: BaseException | None) -> bool:
    """Return whether a disk error caused another error: the content may be good."""
    while error is not None and not isinstance(error, OSError):
        error = error.__cause__
    return error is not None


def _read_images(path: Path) -> None:
    """Read every number of a file of images as a build does, which checks checksums and ranges.

    No `ImageFile` is opened, because the imager is not known here.

    Raises:
        CorruptFile: If it cannot be read.
    """
    with Hdf5File(FileSource(path)) as file:
        if missing := {"images", "scans"} - file.names:
            raise CorruptFile(f"it has no {min(missing)}")
        for name in sorted(file.names):
            dataset = file.dataset(name)
            for start in range(0, dataset.shape[0] if dataset.shape else 0, _ROWS):
                valid_numbers(dataset.rows(start, start + _ROWS))
