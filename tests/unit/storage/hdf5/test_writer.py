"""h5py writes over a file object that hides errors from it, and is never given a file to read."""

import ast
import errno
import os
from pathlib import Path

import numpy as np
import pytest

import app
import core
import storage
from storage.hdf5 import writer as writer_module
from storage.hdf5.writer import _QuietFile, hdf5_on_disk

WRITER = Path(writer_module.__file__)


def test_one_module_imports_h5py_and_only_makes_files_with_it():
    for package in (app, core, storage):
        for path in Path(package.__path__[0]).rglob("*.py"):
            assert path == WRITER or "import h5py" not in path.read_text(), path
    nodes = list(ast.walk(ast.parse(WRITER.read_text())))
    calls = [node for node in nodes if isinstance(node, ast.Call)]
    made = [call for call in calls if ast.unparse(call.func).startswith("h5py")]
    assert {ast.unparse(call) for call in made} == {
        "h5py.File(buffer, 'w', libver=_LIBVER)",
        "h5py.File(quiet, 'w', libver=_LIBVER)",
    }
    types = {
        ast.unparse(node.annotation)
        for node in nodes
        if isinstance(node, ast.arg) and node.annotation
    }
    named = [ast.unparse(node) for node in nodes if isinstance(node, ast.Attribute)]
    assert {name for name in named if name.startswith("h5py.")} <= types | {"h5py.File"}


def test_the_library_reads_nothing_while_it_writes_not_even_rows_of_a_chunk_too_large_to_keep(
    tmp_path, monkeypatch
):
    read = []
    inner = _QuietFile.read

    def seen(*args):
        read.append(args)
        return inner(*args)

    monkeypatch.setattr(_QuietFile, "read", seen)
    large = np.arange(2_000_000, dtype="<f4")  # 8 MB: with two of them, more than HDF5 caches
    with hdf5_on_disk(tmp_path / "a.h5") as writer:
        rows = writer.add_rows("large", "<f4", 4, (2, large.size))
        for row in range(3):
            rows[row] = large
        rows.end()
        many = writer.add_rows("many", "<f4", 9000, (1, 2))
        for row in range(7000):
            many[row] = large[:2]
        many.end()
        writer.add_attributes({"text": "x" * 100_000})
    assert not read


class Refusing:
    """A disk that takes some writes, and then none."""

    def __init__(self, monkeypatch, takes):
        self.left, self.calls = takes, 0
        inner = os.pwrite

        def pwrite(*args):
            self.calls += 1
            self.left -= 1
            if self.left < 0:
                raise OSError(errno.ENOSPC, "no space")
            return inner(*args)

        monkeypatch.setattr(os, "pwrite", pwrite)


def test_after_an_error_no_more_is_written_and_the_next_row_raises_it(tmp_path, monkeypatch):
    disk = Refusing(monkeypatch, takes=3)
    put: list[int] = []
    with pytest.raises(OSError, match="no space"), hdf5_on_disk(tmp_path / "a.h5") as writer:
        put_rows(writer, put)
    assert len(put) < 10
    assert disk.calls == 4


def put_rows(writer, put):
    rows = writer.add_rows("a", "<f4", 100, (1, 50))
    for row in range(100):
        rows[row] = np.zeros(50)
        put.append(row)


def test_later_errors_do_not_hide_the_error_of_the_disk(tmp_path, monkeypatch):
    Refusing(monkeypatch, takes=0)
    with pytest.raises(OSError, match="no space") as caught, hdf5_on_disk(tmp_path / "a.h5"):
        raise RuntimeError("Unable to synchronously close file")
    assert caught.value.errno == errno.ENOSPC


def test_an_error_that_is_not_of_the_disk_is_raised_unchanged(tmp_path):
    with pytest.raises(RuntimeError, match="otherwise"), hdf5_on_disk(tmp_path / "a.h5"):
        raise RuntimeError("otherwise")


@pytest.mark.parametrize("row", [1, -1])
def test_rows_come_one_after_another(tmp_path, row):
    with pytest.raises(ValueError, match="the next is 0"), hdf5_on_disk(tmp_path / "a.h5") as file:
        file.add_rows("a", "<f4", 3, (1, 2))[row] = np.zeros(2)
