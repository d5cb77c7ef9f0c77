"""A damaged file may crash or block its reader; the checking process continues, within limits."""

import errno
import os
import signal
import time
from threading import Thread
from typing import Any

import pytest

from storage.errors import CorruptFile
from storage.files.checker import Checker, Limits
from storage.files.drive_chunks import ChunkFile, scan_digest, write_chunk
from storage.files.stored_file import Fault, StoredFile, fault_of
from tests.support.process import until
from tests.support.small_scans import sample_scan

pytestmark = pytest.mark.slow

SCANS = [(index, sample_scan(index)) for index in range(3)]
CHUNK = "maps/m/drives/d/chunks/c.h5"
DIGESTS = {row: scan_digest(scan.points_m) for row, (_, scan) in enumerate(SCANS)}
SOON = Limits(seconds=8.0)  # a process is started within it


@pytest.fixture
def path(tmp_path):
    write_chunk(tmp_path / "c.h5", SCANS)
    return tmp_path / "c.h5"


@pytest.fixture
def checker():
    with Checker() as made:
        yield made


class EndlessLoop:
    def items(self):
        while True:
            pass


class Silence:
    def items(self):
        time.sleep(600.0)  # a loop would take a core until the limit


class SegmentationFault:
    def items(self):
        os.kill(os.getpid(), signal.SIGSEGV)
        time.sleep(60)


class Killed:
    def items(self):
        os.kill(os.getpid(), signal.SIGKILL)  # as a machine out of memory does
        time.sleep(60)


class MemoryExhausted:
    def items(self):
        return bytearray(2**40)


class Recursion:
    def items(self):
        raise RecursionError("too deep")


def test_a_stored_file_has_no_fault(checker, path):
    assert checker.fault(path, StoredFile(CHUNK, DIGESTS)) is None


@pytest.mark.parametrize(
    ("scans", "what", "certain"),
    [
        (SegmentationFault(), "ended with exit code -11", True),
        (Killed(), "ended with exit code -9", False),
        (MemoryExhausted(), "MB of memory", False),
        (Recursion(), "RecursionError: too deep", True),
    ],
)
def test_a_reader_that_crashes_or_takes_all_memory_is_a_fault_and_the_next_is_read(
    checker, path, scans, what, certain
):
    fault = checker.fault(path, StoredFile(CHUNK, scans))
    assert fault is not None
    assert what in fault.what
    assert fault.certain is certain
    assert checker.fault(path, StoredFile(CHUNK, DIGESTS)) is None


def test_a_reader_that_hangs_is_a_fault_and_the_next_is_read(path):
    hanging: Any = Silence()
    with Checker(SOON) as checker:
        fault = checker.fault(path, StoredFile(CHUNK, hanging))
        assert fault is not None
        assert "more than 8 s" in fault.what
        assert not fault.certain
        assert checker.fault(path, StoredFile(CHUNK, DIGESTS)) is None


def test_a_check_that_is_interrupted_is_no_certain_damage(path):
    endless: Any = EndlessLoop()
    found: list[Fault | None] = []
    with Checker(Limits(seconds=600.0)) as checker:
        checker.interrupt()  # nothing is checked yet
        reading = Thread(
            target=lambda: found.append(checker.fault(path, StoredFile(CHUNK, endless)))
        )
        reading.start()
        until(lambda: checker._child is not None, "nothing is checked")
        checker.interrupt()
        reading.join(60.0)
        assert checker.fault(path, StoredFile(CHUNK, DIGESTS)) is None
    [fault] = found
    assert fault is not None
    assert not fault.certain


def test_a_damaged_row_is_reported_with_the_good_rows(checker, path):
    content = bytearray(path.read_bytes())
    at = content.index(SCANS[1][1].points_m.tobytes()) + 100
    content[at] ^= 1
    path.write_bytes(content)
    fault = checker.fault(path, StoredFile(CHUNK, DIGESTS))
    assert fault is not None
    assert fault.what == "row 1 is not the scan that was put"
    assert fault.good_rows == (0, 2)


def test_a_file_that_is_gone_is_no_damage(checker, path):
    path.unlink()
    with pytest.raises(FileNotFoundError):
        checker.fault(path, StoredFile(CHUNK, DIGESTS))


def test_a_path_that_is_no_file_is_not_opened(checker, path):
    path.unlink()
    os.mkfifo(path)  # to open it would wait for a writer
    fault = checker.fault(path, StoredFile(CHUNK, DIGESTS))
    assert fault is not None
    assert fault.what == "it is no file"


def test_no_process_is_left_when_nothing_is_checked_any_more(path):
    with Checker() as checker:
        checker.fault(path, StoredFile(CHUNK, DIGESTS))
        assert checker._child is not None
        child = checker._child[0].pid
    assert child is not None
    with pytest.raises(ProcessLookupError):
        os.kill(child, 0)


def test_an_error_of_the_disk_is_no_certain_damage(path, monkeypatch):
    def fail(*_):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    for name in ("preadv", "pread"):
        with monkeypatch.context() as failing:
            failing.setattr(os, name, fail)
            fault = fault_of(path, StoredFile(CHUNK, DIGESTS))
        if fault is not None:
            assert not fault.certain, fault
            break
    else:
        pytest.fail("no read of the file failed")


@pytest.mark.parametrize("damaged", [(), (0,), (2,), (0, 2)])
def test_a_row_that_the_disk_cannot_read_is_no_certain_damage_of_the_file(
    path, monkeypatch, damaged
):
    points_m = ChunkFile.points_m

    def read(chunk, row):
        if row == 1:
            raise CorruptFile("row 1 cannot be read") from OSError(errno.EIO, "the disk fails")
        if row in damaged:
            raise CorruptFile(f"row {row} is damaged")
        return points_m(chunk, row)

    monkeypatch.setattr(ChunkFile, "points_m", read)
    fault = fault_of(path, StoredFile(CHUNK, DIGESTS))
    assert fault is not None
    assert not fault.certain
    assert fault.good_rows == tuple(row for row in (0, 2) if row not in damaged)


def test_rows_that_are_damaged_are_certain_damage_and_counted(path, monkeypatch):
    def read(_chunk, row):
        raise CorruptFile(f"row {row} is damaged")

    monkeypatch.setattr(ChunkFile, "points_m", read)
    fault = fault_of(path, StoredFile(CHUNK, DIGESTS))
    assert fault == Fault("row 0 is damaged; 3 of 3 rows are damaged", certain=True, good_rows=())
