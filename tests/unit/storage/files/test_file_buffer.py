"""Images in a file of the temporary folder: those that were put there, and little memory."""

import errno
import math
import os
import tempfile
import tracemalloc
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from core.evaluation.evaluate import EvaluationProtocol, evaluate
from core.mapping.pipeline import project_scans
from core.parameters import MapParameters, Segmentation
from core.projection.images import MemoryBuffer
from storage.errors import StorageFull
from storage.files.file_buffer import FileBuffer
from tests.support.samples import SMALL_GRID, sample_drive

SHAPE = (20, 3, *SMALL_GRID.shape)


def test_the_images_are_those_that_were_put_there():
    images = np.random.default_rng(0).random(SHAPE, dtype=np.float32)
    in_file, in_memory = FileBuffer(SHAPE, SMALL_GRID), MemoryBuffer(SHAPE, SMALL_GRID)
    for row, image in enumerate(images[:18]):
        in_file[row] = in_memory[row] = image
    found, expected = in_file.filled(18), in_memory.filled(18)
    assert (found.grid, len(found)) == (expected.grid, len(expected))
    for start, stop in ((0, 18), (3, 7), (17, 18), (5, 5), (16, 20)):
        read = found.read(start, stop)
        assert read.dtype == np.float32
        np.testing.assert_array_equal(read, expected.read(start, stop))


def test_threads_read_at_the_same_time():
    images = np.random.default_rng(0).random((200, 40, 360), dtype=np.float32)
    buffer = FileBuffer(images.shape, SMALL_GRID)
    for row, image in enumerate(images):
        buffer[row] = image
    found = buffer.filled(len(images))
    with ThreadPoolExecutor(4) as threads:
        read = list(threads.map(lambda row: found.read(row, row + 1)[0], range(len(images))))
    np.testing.assert_array_equal(read, images)


def test_where_the_temporary_folder_is_full_it_is_named_with_the_variable_that_moves_it(
    monkeypatch, tmp_path
):
    def full(descriptor, cells, at):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    buffer = FileBuffer(SHAPE, SMALL_GRID)
    monkeypatch.setattr(os, "pwrite", full)
    with pytest.raises(StorageFull, match="TMPDIR") as raised:
        buffer[0] = np.zeros(SHAPE[1:], np.float32)
    assert str(tmp_path) in str(raised.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("segmentation", Segmentation)
def test_an_evaluation_has_the_same_figures(segmentation):
    drive = sample_drive(30)
    parameters = MapParameters.for_sensor("hdl-64e", segmentation=segmentation)
    protocol = EvaluationProtocol(parameters=parameters, segments=3)

    def evaluated(**where):
        figures = evaluate(drive, protocol, **where).as_dict()
        for condition in figures["conditions"]:
            del condition["ms_per_query"], condition["ms_slowest"]
        return figures

    assert evaluated(new_buffer=FileBuffer) == evaluated()


def test_the_file_of_the_whole_drive_is_gone_before_the_map_is_built(monkeypatch):
    """Cuts of unequal length need images of all scans, the map those of its own."""
    files, open_at = [], {}

    class Counted(FileBuffer):
        def __init__(self, *of):
            super().__init__(*of)
            files.append(self._file)

    class Stages:
        def start(self, stage, total):
            open_at[stage] = [file.closed for file in files].count(False)

        def advance(self, units=1):
            pass

    parameters = MapParameters.for_sensor("hdl-64e", segmentation=Segmentation.UNEQUAL)
    protocol = EvaluationProtocol(parameters=parameters, segments=3)
    evaluate(sample_drive(30), protocol, progress=Stages(), new_buffer=Counted)
    assert (len(files), open_at["projecting"], open_at["fitting"]) == (2, 2, 1)
    assert all(file.closed for file in files)


def test_the_images_are_not_in_memory():
    drive, parameters = sample_drive(60), MapParameters.for_sensor("hdl-64e")

    def peak_bytes(**where):
        tracemalloc.start()
        try:
            images = project_scans(drive, np.arange(60), parameters, most_probes=0, **where)
            for at in range(0, 60, 20):
                images.read(at, at + 20)
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    all_bytes = 60 * 4 * math.prod(parameters.imager.shape)
    assert peak_bytes(new_buffer=FileBuffer) < 0.7 * all_bytes < all_bytes < peak_bytes()
