"""Images in files of the temporary folder: those that were put there, and little memory."""

import errno
import math
import tempfile
import tracemalloc

import numpy as np
import pytest

from core.evaluation.evaluate import EvaluationProtocol, evaluate
from core.mapping.pipeline import project_scans
from core.parameters import MapParameters, Segmentation
from core.projection.images import MemoryRoom
from storage.errors import StorageFull
from storage.files.scratch_images import ScratchImages
from tests.support.samples import SMALL_GRID, sample_drive

SHAPE = (20, 3, *SMALL_GRID.shape)


def test_the_images_are_those_that_were_put_there():
    images = np.random.default_rng(0).random(SHAPE, dtype=np.float32)
    with ScratchImages() as rooms:
        in_file, in_memory = rooms(SHAPE, SMALL_GRID), MemoryRoom(SHAPE, SMALL_GRID)
        for row, image in enumerate(images[:18]):
            in_file[row] = in_memory[row] = image
        found, expected = in_file.filled(18), in_memory.filled(18)
        assert (found.grid, len(found)) == (expected.grid, len(expected))
        for start, stop in ((0, 18), (3, 7), (17, 18), (5, 5), (16, 20)):
            read = found.read(start, stop)
            assert read.dtype == np.float32
            np.testing.assert_array_equal(read, expected.read(start, stop))


def test_where_the_temporary_folder_is_full_it_is_named_with_the_variable_that_moves_it(
    monkeypatch, tmp_path
):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with ScratchImages() as rooms:
        room = rooms(SHAPE, SMALL_GRID)

        class Full:
            def seek(self, at):
                raise OSError(errno.ENOSPC, "No space left on device")

        monkeypatch.setattr(room, "_file", Full())
        with pytest.raises(StorageFull, match="TMPDIR") as raised:
            room[0] = np.zeros(SHAPE[1:], np.float32)
    assert str(tmp_path) in str(raised.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("segmentation", Segmentation)
def test_an_evaluation_has_the_same_figures(segmentation):
    drive = sample_drive(60)
    parameters = MapParameters.for_sensor("hdl-64e", segmentation=segmentation)
    protocol = EvaluationProtocol(parameters=parameters, segments=3)

    def evaluated(**where):
        figures = evaluate(drive, protocol, **where).as_dict()
        for condition in figures["conditions"]:
            del condition["ms_per_query"], condition["ms_slowest"]
        return figures

    with ScratchImages() as rooms:
        assert evaluated(rooms=rooms) == evaluated()


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
    with ScratchImages() as rooms:
        assert peak_bytes(rooms=rooms) < 0.7 * all_bytes < all_bytes < peak_bytes()
