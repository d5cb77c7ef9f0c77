"""A file that the catalog names, and whether it holds what was stored."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from storage.errors import CorruptFile
from storage.files.drive_chunks import ChunkFile, scan_digest
from storage.files.map_file import read_map
from storage.hdf5 import FileSource, Hdf5File

__all__ = ["Fault", "StoredFile", "fault_of"]

_ROWS = 64  # of images, some megabytes


@dataclass(frozen=True)
class StoredFile:
    """A file of the store.

    Attributes:
        path: Under the data directory.
        scans: Digests of the scans that the catalog finds in it, by row.
        revision: Digest of the revision that it holds, `None` if it holds none.
    """

    path: str
    scans: Mapping[int, str] = field(default_factory=dict)
    revision: str | None = None

    @property
    def name(self) -> str:
        """Its name in its folder."""
        return PurePosixPath(self.path).name

    @property
    def kind(self) -> str:
        """What it holds, as its folder: `revisions`, `chunks` or `images`."""
        return PurePosixPath(self.path).parent.name

    @property
    def map_id(self) -> str:
        """The map that it belongs to."""
        return PurePosixPath(self.path).parts[1]

    @property
    def drive_id(self) -> str:
        """The drive that it belongs to, if it is no revision."""
        return PurePosixPath(self.path).parts[3]


@dataclass(frozen=True)
class Fault:
    """What is wrong with a file.

    Attributes:
        what: In words.
        certain: Whether its content is at fault; else it could not be read to its end, and may be
            good.
        good_rows: Of a file of scans: rows that hold what was put.
    """

    what: str
    certain: bool = True
    good_rows: tuple[int, ...] = ()


def fault_of(path: Path, file: StoredFile) -> Fault | None:
    """Read a file to its end; return what is wrong with it, `None` if it is what was stored.

    A disk may keep a reader busy for ever: `storage.files.checker` calls this in its own process.

    Args:
        path: Where it is.
        file: What it should hold.

    Raises:
        FileNotFoundError: If it is gone.
        OSError: If it cannot be read.
    """
    try:
        if file.kind == "images":
            _read_images(path)
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
    for row, wanted in sorted(scans.items()):
        try:
            if scan_digest(chunk.points_m(row)) == wanted:
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


def _is_of_the_disk(error: BaseException | None) -> bool:
    """Return whether an error of the disk caused another: the content may be good."""
    while error is not None and not isinstance(error, OSError):
        error = error.__cause__
    return error is not None


def _read_images(path: Path) -> None:
    """Read every number of a file of images: its checksums are then compared.

    Which imager made them does not matter here, so that no `ImageFile` is opened.

    Raises:
        CorruptFile: If it cannot be read.
    """
    with Hdf5File(FileSource(path)) as file:
        missing = {"images", "scans"} - file.names
        if missing:
            raise CorruptFile(f"it has no {min(missing)}")
        for name in sorted(file.names):
            dataset = file.dataset(name)
            for start in range(0, dataset.shape[0] if dataset.shape else 0, _ROWS):
                dataset.rows(start, start + _ROWS)
