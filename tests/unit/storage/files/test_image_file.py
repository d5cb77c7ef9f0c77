"""Image files: read whole or rejected with a named error."""

import h5py
import numpy as np
import pytest

from core.encodings.grams import drive_gram
from core.errors import Cancelled, EmptyDrive
from core.projection.imager import Imager
from core.projection.images import project_drive
from core.projection.range_image import project_scan
from core.projection.reducer import HEIGHT_REDUCERS, RANGE_REDUCERS, Reducer
from core.projection.rings import RingGrid
from core.scans.drive import MemoryDrive
from core.scans.sensor import AngularGrid
from core.scans.stands import first_of_stands
from storage.errors import CorruptFile, CorruptImages
from storage.files import image_file
from storage.files.image_file import ImageFile, image_file_name, write_image_file
from storage.files.stored_file import StoredFile, fault_of
from tests.support.samples import SMALL_GRID, FaultyDrive, RecordedProgress, sample_drive

LAST = Imager(SMALL_GRID, Reducer.LAST)


@pytest.fixture
def path(tmp_path):
    write_image_file(tmp_path / "images.h5", sample_drive(20), LAST)
    return tmp_path / "images.h5"


@pytest.mark.parametrize("drive", [MemoryDrive("d", []), FaultyDrive(sample_drive(2), {0, 1})])
def test_a_drive_without_a_usable_scan_leaves_no_file(tmp_path, drive):
    with pytest.raises(EmptyDrive, match="has no usable scan"):
        write_image_file(tmp_path / "images.h5", drive, LAST)
    assert list(tmp_path.iterdir()) == []


def test_a_cancelled_projection_leaves_no_file(tmp_path):
    class Stop(RecordedProgress):
        def advance(self, units=1):
            raise Cancelled("enough")

    with pytest.raises(Cancelled):
        write_image_file(tmp_path / "i.h5", sample_drive(3), LAST, Stop())
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_holds_no_images_is_corrupt(tmp_path):
    (tmp_path / "text.h5").write_bytes(b"no HDF5")
    with pytest.raises(CorruptFile, match="holds no images"):
        ImageFile(tmp_path / "text.h5", LAST)


def test_images_that_are_gone_are_named_without_their_folder(tmp_path):
    with pytest.raises(CorruptImages, match=r"^gone\.h5 holds no images: No such file [a-z ]*$"):
        ImageFile(tmp_path / "gone.h5", LAST)


def test_images_of_another_grid_are_corrupt(path):
    with pytest.raises(CorruptFile, match="shape"):
        ImageFile(path, Imager(AngularGrid(), Reducer.LAST))


@pytest.mark.parametrize("name", ["images", "scans"])
def test_a_group_in_place_of_an_array_is_corrupt(path, name):
    with h5py.File(path, "r+") as file:
        del file[name]
        file.create_group(name)
    with pytest.raises(CorruptFile, match="holds no images"):
        ImageFile(path, LAST)


@pytest.mark.parametrize("name", ["returns", "skipped"])
def test_a_missing_attribute_is_corrupt(path, name):
    with h5py.File(path, "r+") as file:
        del file.attrs[name]
    with pytest.raises(CorruptFile, match="holds no images"):
        ImageFile(path, LAST)


def test_a_truncated_file_is_corrupt(path):
    path.write_bytes(path.read_bytes()[:-500])
    with pytest.raises(CorruptFile):
        ImageFile(path, LAST)


@pytest.mark.parametrize("name", ["images", "scans"])
def test_one_bit_that_changed_is_rejected(path, name):
    with h5py.File(path, "r") as file:
        at = file[name].id.get_chunk_info(0).byte_offset
    content = bytearray(path.read_bytes())
    content[at + 40] ^= 1
    path.write_bytes(content)
    with pytest.raises(CorruptFile), ImageFile(path, LAST) as images:
        images.read(0, 20)


@pytest.mark.parametrize("zeros", [b"\0\0\0\0", b"\0\0"], ids=["NaN", "subnormal"])
def test_zeros_changed_to_ones_are_rejected_though_the_checksum_is_the_same(path, zeros):
    with h5py.File(path, "r") as file:
        first = file["images"].id.get_chunk_info(0)
        image = file["images"][0]
    at = first.byte_offset + 4 * int(np.flatnonzero(image.ravel() == 0)[0])
    content = bytearray(path.read_bytes())
    content[at : at + len(zeros)] = b"\xff" * len(zeros)
    path.write_bytes(content)
    with ImageFile(path, LAST) as images, pytest.raises(CorruptImages, match="never written"):
        images.read(0, 1)
    fault = fault_of(path, StoredFile("maps/m/drives/d/images/i.h5"))
    assert fault is not None
    assert "never written" in fault.what


def test_the_name_depends_on_the_version_of_the_projection(monkeypatch):
    name = image_file_name(LAST, "ab" * 32)
    monkeypatch.setattr(image_file, "PROJECTION_VERSION", image_file.PROJECTION_VERSION + 1)
    assert image_file_name(LAST, "ab" * 32) != name


def test_the_projection_makes_what_its_version_made():
    """If this fails on purpose, count `PROJECTION_VERSION` up."""
    cells = 1 + np.arange(np.prod(SMALL_GRID.shape)).reshape(SMALL_GRID.shape)
    scan = sample_drive(1).scan(0)
    sums = {
        reducer.value: float((project_scan(scan, SMALL_GRID, reducer) * cells).sum())
        for reducer in RANGE_REDUCERS
    }
    assert image_file.PROJECTION_VERSION == 1
    assert sums == pytest.approx(
        {"last": 120516.07, "nearest": 106203.78, "farthest": 122701.83, "mean": 114452.8}, rel=1e-5
    )


def test_the_name_depends_on_all_that_the_images_depend_on():
    names = {
        image_file_name(Imager(grid, reducer), digest * 32)
        for grid in (SMALL_GRID, AngularGrid(), AngularGrid(wraps=True))
        for reducer in RANGE_REDUCERS
        for digest in ("ab", "cd")
    }
    names |= {
        image_file_name(Imager(RingGrid(), reducer, height_m, lateral), digest * 32)
        for reducer in HEIGHT_REDUCERS
        for height_m in (1.73, 1.8)
        for lateral in (None, (0.0,), (-1.0, 0.0))
        for digest in ("ab", "cd")
    }
    assert len(names) == 3 * 4 * 2 + 2 * 2 * 3 * 2
    assert image_file_name(Imager(AngularGrid(-25, 1, 30, 1), Reducer.LAST), "ab" * 32) in names
    assert np.char.endswith(list(names), ".h5").all()


def test_renderings_are_read_back_as_they_were_made(tmp_path):
    imager = Imager(RingGrid(), Reducer.MEAN, 1.73, (-1.0, 0.0, 2.0))
    drive = sample_drive(20)
    write_image_file(tmp_path / "renderings.h5", drive, imager)
    with ImageFile(tmp_path / "renderings.h5", imager) as images:
        read = images.read(3, 7)
        assert read.shape == (4, 3, 20, 360)
        for row in range(4):
            np.testing.assert_array_equal(read[row], imager.render(drive.scan(3 + row)))
    with pytest.raises(CorruptFile, match="shape"):
        ImageFile(tmp_path / "renderings.h5", Imager(RingGrid(), Reducer.MEAN))


def test_probes_are_kept_beside_the_images(path):
    projected = project_drive(sample_drive(20), np.arange(20), LAST)
    with ImageFile(path, LAST) as images:
        assert images.probes is not None
        assert images.probed.tolist() == projected.probed.tolist()
        assert (images.probes.read(0, 20) == projected.probes.read(0, 20)).all()


def test_a_file_of_other_probes_still_has_its_images(path):
    with h5py.File(path, "r+") as file:
        file.attrs["probe_version"] = image_file.PROBE_VERSION + 1
    with ImageFile(path, LAST) as images:
        assert images.probes is None
        assert len(images) == 20


@pytest.mark.parametrize("name", ["probes", "probed"])
def test_a_file_that_lacks_its_probes_is_corrupt(path, name):
    with h5py.File(path, "r+") as file:
        del file[name]
    with pytest.raises(CorruptFile, match="holds no images"):
        ImageFile(path, LAST)


@pytest.fixture
def renderings(tmp_path):
    """Images of a drive with lateral renderings, and beside them what a basis is fitted to."""
    imager = Imager(RingGrid(), Reducer.MEAN, 1.73, (-1.5, 0.0, 1.5))
    write_image_file(tmp_path / "renderings.h5", sample_drive(40), imager)
    return tmp_path / "renderings.h5", imager


def test_the_sum_that_is_kept_is_that_of_the_images_and_reads_none(renderings, monkeypatch):
    path, imager = renderings
    with ImageFile(path, imager) as images:
        every = np.ones(len(images), bool)
        kept = images.detail_gram(every)
        assert kept.tobytes() == drive_gram(images, 0, every).tobytes()
        monkeypatch.setattr(images, "read", None)  # none is read again
        assert images.detail_gram(every).tobytes() == kept.tobytes()
    for removed in ("counted", "detail_gram"):  # as files were before
        with h5py.File(path, "r+") as file:
            del file[removed]
        with ImageFile(path, imager) as images:
            assert images.detail_gram(every).tobytes() == kept.tobytes()


def test_of_a_stand_one_scan_counts_in_the_sum_whenever_the_file_was_written(tmp_path):
    imager = Imager(RingGrid(), Reducer.MEAN, 1.73, (-1.5, 0.0, 1.5))
    drive, path = sample_drive(40), tmp_path / "stand.h5"
    drive.poses = drive.poses.copy()
    drive.poses[10:30, :3] = drive.poses[10, :3]
    write_image_file(path, drive, imager)
    counted = first_of_stands(drive.poses)
    assert np.flatnonzero(~counted).tolist() == list(range(11, 30))
    with ImageFile(path, imager) as images:
        every = images.detail_gram(np.ones(40, bool))
        of_places = images.detail_gram(counted)
        assert of_places.tobytes() == drive_gram(images, 0, counted).tobytes()
        assert np.trace(of_places) < 0.7 * np.trace(every)
    with h5py.File(path, "r+") as file:  # as before stands were known: all counted
        del file["counted"]
        file["detail_gram"][...] = every
    with ImageFile(path, imager) as images:
        assert images.detail_gram(counted).tobytes() == of_places.tobytes()


def test_a_sum_that_is_not_what_was_written_is_rejected(renderings):
    path, imager = renderings
    with h5py.File(path, "r") as file:
        at = file["detail_gram"].id.get_chunk_info(0).byte_offset
    whole = bytearray(path.read_bytes())
    whole[at + 9] ^= 1
    path.write_bytes(whole)
    with ImageFile(path, imager) as images, pytest.raises(CorruptImages, match="cannot be read"):
        images.detail_gram(np.ones(40, bool))
    with h5py.File(path, "r+") as file:
        del file["detail_gram"]
        file["detail_gram"] = np.zeros((3, 3))
    with ImageFile(path, imager) as images, pytest.raises(CorruptImages, match="shape"):
        images.detail_gram(np.ones(40, bool))


@pytest.mark.parametrize("name", ["images", "probes"])
def test_a_block_of_images_that_became_zeros_with_its_checksum_is_rejected(renderings, name):
    path, imager = renderings
    with h5py.File(path, "r") as file:
        chunk = file[name].id.get_chunk_info(1)
    whole = bytearray(path.read_bytes())
    whole[chunk.byte_offset : chunk.byte_offset + chunk.size] = bytes(chunk.size)
    path.write_bytes(whole)
    with ImageFile(path, imager) as images:
        source = images if name == "images" else images.probes
        assert source is not None
        source.read(0, 1)
        with pytest.raises(CorruptImages, match="other numbers of occupied cells than when writt"):
            source.read(0, len(source))


def test_a_file_from_before_cells_were_counted_is_read(renderings):
    path, imager = renderings
    with ImageFile(path, imager) as images:
        assert images.probes is not None
        before = images.read(0, len(images)), images.probes.read(0, len(images.probes))
    with h5py.File(path, "r+") as file:
        del file["occupied"], file["probes_occupied"]
    with ImageFile(path, imager) as images:
        assert images.probes is not None
        np.testing.assert_array_equal(images.read(0, len(images)), before[0])
        np.testing.assert_array_equal(images.probes.read(0, len(images.probes)), before[1])
