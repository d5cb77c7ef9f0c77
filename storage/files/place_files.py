"""The index of all places of one basis, as files that any process can make anew.

    <folder>/index.json        names the folders in use, and the maps in each; replaced as a whole
    <folder>/part-<id>/        entries of some maps, each array a NumPy file

Nothing in it is the only copy: what is missing or damaged is removed and made again.
"""

import fcntl
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from storage.files.files import make_folder, named_disk_errors, publish, sync
from storage.names import new_id

VERSION = 3
_NAME = "index.json"


class IndexedMap(BaseModel):
    """A map in a part: its places are `start` to `end`, as of a slice."""

    map_id: str
    revision: str
    start: int
    end: int


class Part(BaseModel):
    """A part of an index: its folder, and its maps, without those that are gone."""

    folder: str
    maps: list[IndexedMap]


class Manifest(BaseModel):
    """What an index has.

    Attributes:
        version: Of this layout.
        parts: The parts, the largest first.
    """

    version: int
    parts: list[Part]


class PlaceFiles:
    """The files of one index.

    Args:
        folder: Of the index; it need not exist.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def manifest(self) -> Manifest | None:
        """Return what the index has, `None` if there is none that can be read."""
        try:
            found = Manifest.model_validate_json((self._folder / _NAME).read_bytes())
        except (OSError, ValueError):
            return None
        return found if found.version == VERSION else None

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
        descriptor = os.open(self._folder / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                yield False
            else:
                yield True
        finally:
            os.close(descriptor)

    def write(self, kind: str, arrays: Mapping[str, NDArray[Any]]) -> str:
        """Write arrays to a new folder, wait until they are on disk, and return its name."""
        name = f"{kind}-{new_id()}"
        folder = make_folder(self._folder / name)
        with named_disk_errors():
            for key, array in arrays.items():
                path = folder / f"{key}.npy"
                np.save(path, array, allow_pickle=False)
                sync(path)
            sync(folder)
        return name

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
            part.write_text(manifest.model_dump_json())
        named = {part.folder for part in manifest.parts}
        for path in self._folder.iterdir():
            if path.is_dir() and path.name not in named:
                shutil.rmtree(path, ignore_errors=True)

    def remove(self) -> None:
        """Remove the index."""
        shutil.rmtree(self._folder, ignore_errors=True)
