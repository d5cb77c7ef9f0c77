"""Reads damaged files with our readers, in a process that a parent watches.

`python -m tests.torture.support.reading SUBJECT FOLDER FIRST LAST` reads the files of these numbers
in `FOLDER/given` or, without that folder, made anew from the seed, and reports before and after
each one how it fared.
"""

import abc
import hashlib
import resource
import shutil
import sys
import time
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.errors import TensorMapError
from core.scans.scan import Scan
from storage.backup.backup import write_backup
from storage.backup.restore import restore_backup
from storage.catalog import RevisionFacts
from storage.files.drive_chunks import ChunkFile, write_chunk
from storage.files.image_file import ImageFile, write_image_file
from storage.files.map_file import read_map, write_map
from storage.store import Store
from tests.support.samples import (
    calibrated_map,
    sample_drive,
    sample_harmonic_map,
    sample_map,
)
from tests.torture.support.costs import forget_peak, peak_kb
from tests.torture.support.damage import damaged
from tests.torture.support.sizes import chance

_MEMORY_BYTES = 2 * 2**30  # beyond, allocating fails: a reader that allocates more is refused


class Subject(abc.ABC):
    """A kind of file: a sound one, and how it is read."""

    @abc.abstractmethod
    def make(self, folder: Path) -> Path:
        """Write a sound file and return it."""

    @abc.abstractmethod
    def read(self, path: Path) -> str:
        """Read it as the service does, to its last byte.

        Returns:
            A digest of its content; the same of all, where the file alone does not protect it.
        """


class PaperMap(Subject):
    """A revision in the paper's encoding."""

    def make(self, folder: Path) -> Path:
        write_map(folder / "sound.h5", sample_map()[0])
        return folder / "sound.h5"

    def read(self, path: Path) -> str:
        return read_map(path).revision


class HarmonicMap(PaperMap):
    """A harmonic revision."""

    def make(self, folder: Path) -> Path:
        write_map(folder / "sound.h5", sample_harmonic_map()[0])
        return folder / "sound.h5"


class CalibratedMap(PaperMap):
    """A revision with a calibration."""

    def make(self, folder: Path) -> Path:
        write_map(folder / "sound.h5", calibrated_map(60))
        return folder / "sound.h5"


class Chunk(Subject):
    """A chunk file of scans."""

    def make(self, folder: Path) -> Path:
        rng = np.random.default_rng(0)
        points = [rng.normal(size=(40 + i, 3)).astype(np.float32) for i in range(4)]
        write_chunk(folder / "sound.h5", [(i, Scan(p)) for i, p in enumerate(points)])
        return folder / "sound.h5"

    def read(self, path: Path) -> str:
        chunk = ChunkFile(path)
        for row in range(4):
            chunk.points_m(row)
        return ""  # the catalog has the digests of scans


class Images(Subject):
    """A file of images that builds keep."""

    def __init__(self) -> None:
        self._imager = sample_harmonic_map()[0].parameters.imager

    def make(self, folder: Path) -> Path:
        write_image_file(folder / "sound.h5", sample_drive(12), self._imager)
        return folder / "sound.h5"

    def read(self, path: Path) -> str:
        with ImageFile(path, self._imager) as images:
            parts: list[NDArray[Any]] = [
                images.scans,
                images.read(0, len(images)),
                images.detail_gram(np.ones(len(images), bool)),
            ]
            if images.probes is not None:
                parts.append(images.probes.read(0, len(images.probes)))
        return hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()


class Backup(Subject):
    """A backup."""

    def make(self, folder: Path) -> Path:
        _filled_store(folder / "data")
        write_backup(folder / "data", folder / "sound.tar")
        return folder / "sound.tar"

    def read(self, path: Path) -> str:
        new = path.with_name("restored")
        try:
            restore_backup(path, new)
            files = sorted(new.glob("maps/**/*.h5"))
            contents = {str(file.relative_to(new)): file.read_bytes() for file in files}
            return hashlib.sha256(repr(contents).encode()).hexdigest()
        finally:
            shutil.rmtree(new, ignore_errors=True)


class Catalog(Subject):
    """SQLite's file, opened as a service opens it."""

    def make(self, folder: Path) -> Path:
        _filled_store(folder / "data")
        return folder / "data" / "catalog.sqlite3"

    def read(self, path: Path) -> str:
        data = path.parent / "data"
        for log in ("-wal", "-shm"):
            (data / f"catalog.sqlite3{log}").unlink(missing_ok=True)
        path.replace(data / "catalog.sqlite3")
        with Store.serving(data) as store:
            store.maps.list()
            store.drives.list("campus")
            store.drives.read_scan("campus", "monday", 0)
            store.revisions.list("campus")
            store.jobs.list()
            store.keys.list()
        return ""  # SQLite has no digests of rows


SUBJECTS: dict[str, type[Subject]] = {
    subject.__name__: subject
    for subject in (PaperMap, HarmonicMap, CalibratedMap, Chunk, Images, Backup, Catalog)
}


def damaged_file(sound: bytes, subject: str, number: int) -> bytes:
    """Return damaged file `number` of this seed."""
    return damaged(sound, chance("damage", subject, number))


def _filled_store(data_dir: Path) -> None:
    facts = RevisionFacts(encoding="paper", scans=24, segments=3, parameters={})
    tensor_map, _ = sample_map()
    rng = np.random.default_rng(0)
    with Store(data_dir) as store:
        of_map = store.maps.create("campus")
        for index in range(2):
            scan = Scan(rng.normal(size=(40, 3)).astype(np.float32))
            store.drives.put_scan("campus", "monday", index, scan)
        digest = tensor_map.revision
        store.revisions.add(of_map.id, digest, lambda path: write_map(path, tensor_map), facts)
        store.keys.add("hash", ["admin"])


def _main(name: str, folder: Path, first: int, last: int) -> None:
    subject = SUBJECTS[name]()
    given_files, folder = folder / "given", Path(mkdtemp(dir=folder, prefix=f"from-{first}-"))
    sound = subject.make(folder).read_bytes()
    whole = subject.read(_placed(folder, sound))  # what is imported late is imported now
    _, most = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY_BYTES, most))
    for number in range(first, last):
        given = given_files / str(number)
        content = given.read_bytes() if given.exists() else damaged_file(sound, name, number)
        path = _placed(folder, content)
        print(f"begin {number}", flush=True)
        forget_peak()
        began = time.process_time()
        try:
            how = "read" if subject.read(path) == whole else "unnamed other content"
        except TensorMapError as error:
            how = type(error).__name__
        except Exception as error:  # noqa: BLE001 - what has no name is what is looked for
            how = f"unnamed {error!r}"[:300].replace("\n", " ")
        cpu_s = time.process_time() - began
        print(f"end {number} {cpu_s:.3f} {peak_kb()} {how}", flush=True)


def _placed(folder: Path, content: bytes) -> Path:
    path = folder / "damaged"
    path.unlink(missing_ok=True)
    path.write_bytes(content)
    return path


if __name__ == "__main__":
    _main(sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]))
