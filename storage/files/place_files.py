"""The index of all places of one basis, as files that any process can make anew.

    <folder>/index.json        names the folders in use, the maps in each and the checksums of its
                               files; replaced as a whole
    <folder>/part-<id>/        entries of some maps, each array a NumPy file

Nothing in it is the only copy: what is missing or damaged is removed and made again.
"""

import fcntl
import os
import shutil
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from storage.files.files import discard, make_folder, named_disk_errors, publish, sync
from storage.files.free_space import OF_SCANS
from storage.names import new_id

VERSION = 4
_NAME, _LOCK = "index.json", "lock"
_AT_ONCE_BYTES = 2**22


class IndexedMap(BaseModel):
    """A map in a part: its places are `start` to `end`, as of a slice."""

    map_id: str
    revision: str
    start: int
    end: int


class Part(BaseModel):
    """A part of an index.

    Attributes:
        folder: The part's folder.
        maps: The part's maps, without those that are gone.
        checksums: CRC-32 of each array's file, by the array's name.
    """

    folder: str
    maps: list[IndexedMap]
    checksums: dict[str, int]


class Manifest(BaseModel):
    """What an index has.

    Attributes:
        version: The version of this layout.
        parts: The parts.
    """

    version: int
    parts: list[Part]


class _StoredManifest(BaseModel):
    """A manifest with its CRC-32: a place may be of another map if one digit in it changes."""

    checksum: int
    manifest: Manifest


class PlaceFiles:
    """The files of one index.

    Args:
        folder: The index's folder; it need not exist.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def manifest(self) -> Manifest | None:
        """Return what the index has, `None` if there is none that can be read."""
        try:
            stored = _StoredManifest.model_validate_json((self._folder / _NAME).read_bytes())
        except (OSError, ValueError):
            return None
        found = stored.manifest
        is_ours = found.version == VERSION and stored.checksum == _checksum_of(found)
        return found if is_ours else None

    def written(self) -> tuple[int, int] | None:
        """Return what changes whenever the manifest is replaced, `None` if there is none."""
        try:
            found = (self._folder / _NAME).stat()
        except OSError:
            return None
        return found.st_mtime_ns, found.st_ino

    @contextmanager
    def locked(self) -> Iterator[bool]:
        """Yield whether no other process or thread writes; hold the lock within the block."""
        make_folder(self._folder)
        descriptor = os.open(self._folder / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                yield False
            else:
                yield True
        finally:
            os.close(descriptor)

    def write(self, arrays: Mapping[str, NDArray[Any]], maps: list[IndexedMap]) -> Part:
        """Write the arrays of some maps to a new folder, and wait until they are on disk.

        Raises:
            StorageFull: If there is no space for them besides what is kept for the catalog; nothing
                is left behind.
        """
        name = f"part-{new_id()}"
        folder = make_folder(self._folder / name)
        checksums = {}
        try:
            with named_disk_errors():
                size_bytes = sum(array.nbytes for array in arrays.values())
                OF_SCANS.require(folder, size_bytes, "a part of an index")
                for key, array in arrays.items():
                    path = folder / f"{key}.npy"
                    np.save(path, array, allow_pickle=False)
                    sync(path)
                    checksums[key] = _checksum(path)
                sync(folder)
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)
            raise
        return Part(folder=name, maps=maps, checksums=checksums)

    def matches_checksums(self, part: Part) -> bool:
        """Return whether the files of a part hold what was written; it reads them to their end."""
        folder = self._folder / part.folder
        try:
            return all(
                _checksum(folder / f"{key}.npy") == wanted for key, wanted in part.checksums.items()
            )
        except OSError:
            return False

    def read(self, name: str) -> dict[str, NDArray[Any]]:
        """Return the arrays of a folder, mapped into memory.

        Raises:
            OSError: If one cannot be read.
            ValueError: If one is no array, or cut off.
        """
        paths = sorted((self._folder / name).glob("*.npy"))
        try:
            return {path.stem: np.load(path, mmap_mode="r") for path in paths}
        except EOFError as error:
            raise ValueError(f"an array of {name} is cut off: {error}") from error

    def replace(self, manifest: Manifest) -> None:
        """Put a manifest in the place of the last one, and remove what it does not name.

        A process that has removed files mapped can read them to the end.
        """
        with publish(self._folder / _NAME) as part:
            stored = _StoredManifest(checksum=_checksum_of(manifest), manifest=manifest)
            part.write_text(stored.model_dump_json())
        named = {_NAME, _LOCK, *(part.folder for part in manifest.parts)}
        for path in self._folder.iterdir():
            if path.name in named:
                continue
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:  # a manifest that a killed process wrote
                discard(path)

    def remove(self) -> None:
        """Remove the index."""
        shutil.rmtree(self._folder, ignore_errors=True)


def _checksum_of(manifest: Manifest) -> int:
    return zlib.crc32(manifest.model_dump_json().encode())


def _checksum(path: Path) -> int:
    """Return the CRC-32 of a file. It is not mapped: then a failing disk would end the process."""
    found = 0
    with path.open("rb") as file:
        while piece := file.read(_AT_ONCE_BYTES):
            found = zlib.crc32(piece, found)
    return found
