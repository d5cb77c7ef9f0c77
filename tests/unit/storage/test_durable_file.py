"""Nothing gets its name before what is on disk was read back, whichever write fails."""

import errno
import functools
import os

import numpy as np
import pytest

from core.projection.imager import Imager
from core.projection.probe import probe_image
from core.projection.reducer import Reducer
from core.projection.rings import RingGrid
from core.scans.scan import Scan
from storage.durable_file import DurableFile
from storage.errors import StorageFull, StorageUnavailable, with_cause
from storage.files.drive_chunks import ChunkFile, write_chunk
from storage.files.files import publish
from storage.files.image_file import ImageFile, write_image_file
from storage.files.map_file import read_map, write_map
from tests.support.samples import SMALL_GRID, FaultyDrive, sample_drive, sample_map

pytestmark = pytest.mark.slow

MAP, _ = sample_map(count=12, segment_length=4, drives=2)
# Of ten images a file has a block and a part of one; of seven renderings three and a part.
DRIVES = [FaultyDrive(sample_drive(12), {3, 8}), sample_drive(7)]
IMAGERS = [
    Imager(SMALL_GRID, Reducer.LAST),
    Imager(RingGrid(), Reducer.MEAN, 1.73, (-1.5, 0.0, 1.5)),
]


rendered, probed = functools.cache(Imager.render), functools.cache(probe_image)


@pytest.fixture(autouse=True)
def projected_once(monkeypatch):
    """Project each scan once: files are written a hundred times, another call failing each time."""
    monkeypatch.setattr(Imager, "render", lambda imager, scan: rendered(imager, scan))
    monkeypatch.setattr("core.projection.images.probe_image", probed)


def put_map(path):
    with publish(path) as part:
        write_map(part, MAP)


def put_chunk(path):
    scans = [Scan.from_returns(np.full((n, 3), 2.0), min_returns=0) for n in (5, 0, 40_000)]
    write_chunk(path, list(enumerate(scans)))


def put_images(path):
    write_image_file(path, DRIVES[0], IMAGERS[0])


def put_renderings(path):
    write_image_file(path, DRIVES[1], IMAGERS[1])


def content_of_images(path, imager):
    with ImageFile(path, imager) as images:
        assert images.probes is not None
        parts = (images, images.probes)
        cells = b"".join(part.read(0, len(part)).tobytes() for part in parts)
        facts = [images.scans.tolist(), images.probed.tolist(), images.displacement.tolist()]
        return (
            cells,
            facts,
            images.detail_gram(np.ones(len(images), bool)).tolist(),
            images.returns,
            images.skipped,
        )


WRITERS = {
    "map": (put_map, lambda path: read_map(path).revision),
    "chunk": (put_chunk, lambda path: ChunkFile(path).points_m(2).tobytes()),
    "images": (put_images, lambda path: content_of_images(path, IMAGERS[0])),
    "renderings": (put_renderings, lambda path: content_of_images(path, IMAGERS[1])),
}


@pytest.fixture(params=WRITERS)
def written(request, tmp_path):
    """How a kind of file is written and read, and the content of a whole one."""
    write, read = WRITERS[request.param]
    write(tmp_path / "whole.h5")
    whole = read(tmp_path / "whole.h5")
    (tmp_path / "whole.h5").unlink()
    return write, read, whole


class Disk:
    """The calls of the disk, of which the n-th fails."""

    def __init__(self, monkeypatch, name, fail):
        self.calls, self.fail_at = 0, -1
        inner = getattr(os, name)

        def call(*args):
            self.calls += 1
            return fail(inner, *args) if self.calls == self.fail_at else inner(*args)

        monkeypatch.setattr(os, name, call)


def raise_error(number):
    def fail(_inner, *_args):
        raise OSError(number, os.strerror(number))

    return fail


def each_failing(disk, write, path):
    """Write again and again, another call failing each time; yield what it ended in."""
    write(path)
    path.unlink()
    for number in range(1, disk.calls + 1):
        disk.calls, disk.fail_at = 0, number
        try:
            write(path)
        except StorageUnavailable:
            yield number, errno.EIO
        except StorageFull:
            yield number, errno.ENOSPC
        else:
            yield number, None


@pytest.mark.parametrize(
    ("name", "number"),
    [("pwrite", errno.EIO), ("pwrite", errno.ENOSPC), ("fsync", errno.EIO), ("open", errno.EIO),
     ("ftruncate", errno.ENOSPC)],
)  # fmt: skip
def test_each_failing_call_raises_and_leaves_no_file(written, tmp_path, monkeypatch, name, number):
    write, _, _ = written
    disk = Disk(monkeypatch, name, raise_error(number))
    path = tmp_path / "a.h5"
    ends = list(each_failing(disk, write, path))
    assert len(ends) >= {"ftruncate": 0, "fsync": 2}.get(name, 1)  # the first is of images only
    for call, error in ends[: -1 if name == "fsync" else None]:  # the last one is the folder's
        assert error is not None, f"{name} {call} failed without an error"
        assert not path.exists() or name in {"fsync", "open"}
    assert not list(tmp_path.glob(".*.part"))


def test_a_file_is_synced_before_it_gets_its_name_and_its_folder_after_that(
    written, tmp_path, monkeypatch
):
    """Neither is of use alone: a power failure leaves an empty file, or none."""
    write, _, _ = written
    calls = []

    def note(name, subject):
        inner = getattr(os, name)

        def call(*args):
            calls.append((name, subject(args[0]).st_ino))
            return inner(*args)

        monkeypatch.setattr(os, name, call)

    for name in ("pwrite", "ftruncate", "fsync"):
        note(name, os.fstat)
    note("rename", os.stat)
    path = tmp_path / "a.h5"
    write(path)
    file, folder = path.stat().st_ino, tmp_path.stat().st_ino
    changing = {("pwrite", file), ("ftruncate", file)}
    changes = [at for at, call in enumerate(calls) if call in changing]
    assert changes
    after = [call for call in calls[max(changes) + 1 :] if call[1] in {file, folder}]
    assert list(dict.fromkeys(after)) == [("fsync", file), ("rename", file), ("fsync", folder)]


def short(inner, descriptor, content, at):
    return inner(descriptor, content[: max(1, len(content) // 2)], at)


def lost(_inner, _descriptor, content, _at):
    return len(content)


def other(inner, descriptor, content, at):
    changed = bytearray(content)
    changed[len(changed) // 2] ^= 16
    return inner(descriptor, changed, at)


def test_a_write_that_takes_less_is_followed_by_another(written, tmp_path, monkeypatch):
    write, read, whole = written
    disk = Disk(monkeypatch, "pwrite", short)
    path = tmp_path / "a.h5"
    for _, error in each_failing(disk, write, path):
        assert error is None
        assert read(path) == whole
        path.unlink()


@pytest.mark.parametrize("fault", [lost, other])
def test_bytes_that_are_not_on_the_disk_as_written_are_found(written, tmp_path, monkeypatch, fault):
    """Unless they do not matter: the library writes some places again, and leaves gaps."""
    write, read, whole = written
    disk = Disk(monkeypatch, "pwrite", fault)
    path = tmp_path / "a.h5"
    found = 0
    for call, error in each_failing(disk, write, path):
        if error is None:
            assert read(path) == whole, f"write {call} was not read back"
            path.unlink()
        else:
            assert error == errno.EIO
            found += 1
        assert not list(tmp_path.iterdir())
    assert found > disk.calls // 2


def test_returns_that_are_read_back_as_others_are_not_stored(tmp_path, monkeypatch):
    scan = Scan.from_returns([[1.0, 2.0, 3.0]])
    monkeypatch.setattr(ChunkFile, "points_m", lambda _self, _row: scan.points_m + 1)
    with pytest.raises(StorageUnavailable) as failed:
        write_chunk(tmp_path / "a.h5", [(0, scan)])
    assert "row 0 has other returns" in with_cause(failed.value)
    assert not list(tmp_path.iterdir())


def test_a_file_is_readable_by_this_user_only(written, tmp_path):
    write, _, _ = written
    write(tmp_path / "a.h5")
    assert (tmp_path / "a.h5").stat().st_mode & 0o777 == 0o600


def test_a_file_that_is_there_is_not_written_over(tmp_path):
    (tmp_path / "a.h5").write_bytes(b"kept")
    for write in (lambda path: write_map(path, MAP), DurableFile):
        with pytest.raises(FileExistsError):
            write(tmp_path / "a.h5")
    assert (tmp_path / "a.h5").read_bytes() == b"kept"
