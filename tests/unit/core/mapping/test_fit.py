"""From images to a map: the same content whatever the blocks, drives apart, cancellable."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.encodings.paper.model import PaperModel
from core.errors import Cancelled, EmptyDrive, InvalidImage, InvalidParameters, SensorMismatch
from core.mapping.fit import fit_map
from core.mapping.pipeline import build
from core.parameters import MapParameters
from core.projection.imager import Imager
from core.projection.images import ConcatenatedImages, MemoryImages, project_drive
from core.projection.reducer import Reducer
from core.scans.accumulation import AccumulatedDrive
from core.scans.sensor import AngularGrid
from core.scans.trajectory import Trajectory
from storage.files.image_file import ImageFile, write_image_file
from tests.support.samples import (
    SMALL_GRID,
    FaultyDrive,
    RecordedProgress,
    random_images,
    sample_drive,
    sample_map,
    straight_poses,
)

PARAMETERS = MapParameters(grid=SMALL_GRID, ranks=(3, 4))


def trajectory_of(count, name="drive-0"):
    return Trajectory.of_drive(
        name, 0.1 * np.arange(count, dtype=np.float64), straight_poses(count), np.arange(count)
    )


def built(images, cuts, progress=None):
    source = images if hasattr(images, "read") else MemoryImages(images, SMALL_GRID)
    arguments = () if progress is None else (progress,)
    return fit_map(source, trajectory_of(len(source)), np.array(cuts), PARAMETERS, *arguments)


def test_the_bases_are_orthonormal_and_errors_are_those_of_the_models():
    images = random_images(90, SMALL_GRID.shape)
    tensor_map = built(images, [0, 40, 90])
    model = tensor_map.model
    for segment, scans in enumerate((slice(0, 40), slice(40, 90))):
        u, v = model.elevation_basis[segment], model.azimuth_basis[segment]
        np.testing.assert_allclose(u.T @ u, np.eye(3), atol=1e-6)
        np.testing.assert_allclose(v.T @ v, np.eye(4), atol=1e-6)
        own = images[scans]
        rebuilt = np.einsum("ir,nrs,js->nij", u, model.signatures[scans], v)
        error = np.linalg.norm(own - rebuilt) / np.linalg.norm(own)
        assert tensor_map.relative_error[segment] == pytest.approx(error, abs=1e-5)


def test_progress_counts_every_image_of_both_passes():
    progress = RecordedProgress()
    built(random_images(90, SMALL_GRID.shape), [0, 40, 90], progress)
    assert progress.stages == [("fitting", 180)]
    assert progress.done == [180]


@pytest.mark.parametrize("after", [0, 32, 40, 100, 180])
def test_progress_can_stop_a_build_at_every_block(after):
    class Stop(RecordedProgress):
        def advance(self, units=1):
            super().advance(units)
            if self.done[-1] >= after:
                raise Cancelled("enough")

    progress = Stop()
    with pytest.raises(Cancelled, match="enough"):
        built(random_images(90, SMALL_GRID.shape), [0, 40, 90], progress)
    assert after <= progress.done[-1] < after + 41


class _Fortran:
    """Reads the same images in another memory layout."""

    def __init__(self, images):
        self.grid, self._images = SMALL_GRID, np.asfortranarray(images)

    def __len__(self):
        return len(self._images)

    def read(self, start, stop):
        return np.concatenate([self._images[i : i + 1] for i in range(start, stop)])


def test_equal_input_is_an_equal_revision_however_it_is_read():
    images = random_images(90, SMALL_GRID.shape)
    cuts = [0, 40, 90]
    revision = built(images, cuts).revision
    assert built(images.copy(), cuts).revision == revision
    assert built(_Fortran(images), cuts).revision == revision
    parts = [MemoryImages(part, SMALL_GRID) for part in np.split(images, [1, 13, 64])]
    assert built(ConcatenatedImages(parts), cuts).revision == revision
    images[0, 1, 1] += 1.0
    assert built(images, cuts).revision != revision


def test_a_revision_is_64_hexadecimal_digits_and_changes_with_every_difference():
    images = random_images(20, SMALL_GRID.shape)
    source, cuts = MemoryImages(images, SMALL_GRID), np.array([0, 10, 20])
    plain = fit_map(source, trajectory_of(20), cuts, PARAMETERS)
    assert len(bytes.fromhex(plain.revision)) == 32
    others = [
        fit_map(source, trajectory_of(20), np.array([0, 11, 20]), PARAMETERS),
        fit_map(
            source,
            trajectory_of(20),
            cuts,
            MapParameters(grid=SMALL_GRID, ranks=(3, 4), sensor_height_m=1.8),
        ),
        fit_map(
            source,
            trajectory_of(20),
            cuts,
            MapParameters(grid=SMALL_GRID, ranks=(3, 4), reducer=Reducer.MEAN),
        ),
        fit_map(
            source,
            Trajectory.of_drive(
                "other", trajectory_of(20).timestamp_s, straight_poses(20), np.arange(20)
            ),
            cuts,
            PARAMETERS,
        ),
    ]
    assert len({plain.revision, *(other.revision for other in others)}) == 5


def test_a_drive_built_alone_has_the_models_it_has_among_others():
    together, images = sample_map(count=24, segment_length=8, drives=2)
    alone = fit_map(
        MemoryImages(images[24:], SMALL_GRID),
        together.trajectory.select(np.arange(24, 48)),
        np.array([0, 8, 16, 24]),
        together.parameters,
    )
    np.testing.assert_array_equal(alone.model.signatures, together.model.signatures[24:])
    assert isinstance(alone.model, PaperModel)
    assert isinstance(together.model, PaperModel)
    np.testing.assert_array_equal(alone.model.elevation_basis, together.model.elevation_basis[3:])
    assert together.topology.edge_nodes.tolist() == [[0, 1], [1, 2], [2, 3], [4, 5], [5, 6], [6, 7]]
    assert together.topology.node_scan.tolist() == [0, 8, 16, 23, 24, 32, 40, 47]


def test_images_on_another_grid_are_rejected():
    with pytest.raises(SensorMismatch, match="the images are on"):
        fit_map(
            MemoryImages(random_images(4, (30, 361)), AngularGrid()),
            trajectory_of(4),
            np.array([0, 4]),
            PARAMETERS,
        )


@pytest.mark.parametrize("cuts", [[0, 9], [0, 11], [1, 10], [0, 5, 5, 10], [0, 7, 3, 10], [10], []])
def test_cuts_that_do_not_cover_the_images_are_rejected(cuts):
    with pytest.raises(InvalidParameters, match="the cuts"):
        built(random_images(10, SMALL_GRID.shape), np.array(cuts, dtype=np.int64))


def test_a_segment_over_two_drives_is_rejected():
    joined = Trajectory.concatenate([trajectory_of(5), trajectory_of(5, "drive-1")])
    source = MemoryImages(random_images(10, SMALL_GRID.shape), SMALL_GRID)
    with pytest.raises(InvalidParameters, match="drive"):
        fit_map(source, joined, np.array([0, 7, 10]), PARAMETERS)


def test_a_source_that_reads_short_is_rejected():
    class Short(_Fortran):
        def read(self, start, stop):
            return super().read(start, stop)[1:]

    with pytest.raises(InvalidImage, match=r"read \(9, 6, 19\)"):
        built(Short(random_images(10, SMALL_GRID.shape)), [0, 10])


def test_images_of_nothing_make_a_model_of_nothing_without_an_error():
    tensor_map = built(np.zeros((4, *SMALL_GRID.shape), np.float32), [0, 4])
    assert tensor_map.relative_error.tolist() == [0.0]
    assert not tensor_map.model.signatures.any()


# Images


@given(st.lists(st.integers(0, 7), min_size=1, max_size=6), st.data())
def test_concatenated_images_read_as_one_array(sizes, data):
    images = random_images(sum(sizes), SMALL_GRID.shape)
    parts = np.split(images, np.cumsum(sizes)[:-1])
    joined = ConcatenatedImages([MemoryImages(part, SMALL_GRID) for part in parts])
    assert len(joined) == len(images)
    start = data.draw(st.integers(0, len(images)))
    stop = data.draw(st.integers(start, len(images)))
    np.testing.assert_array_equal(joined.read(start, stop), images[start:stop])


def test_images_are_joined_on_one_grid_only():
    small = MemoryImages(random_images(1, SMALL_GRID.shape), SMALL_GRID)
    large = MemoryImages(random_images(1, (30, 361)), AngularGrid())
    for parts in ([small, large], []):
        with pytest.raises(InvalidImage, match="one grid"):
            ConcatenatedImages(parts)
    with pytest.raises(InvalidImage, match=r"shape \(6, 19\), the grid \(30, 361\)"):
        MemoryImages(random_images(1, SMALL_GRID.shape), AngularGrid())


def test_projecting_a_drive_skips_unusable_scans_and_reports_why():
    drive = FaultyDrive(sample_drive(8), {2, 5})
    progress = RecordedProgress()
    projected = project_drive(drive, np.arange(1, 8), Imager(SMALL_GRID, Reducer.MEAN), progress)
    assert projected.scans.tolist() == [1, 3, 4, 6, 7]
    assert len(projected.images) == 5
    assert [(item.scan, item.reason) for item in projected.skipped] == [
        (2, "scan 2 is torn"),
        (5, "scan 5 is torn"),
    ]
    assert projected.returns == 5 * 60
    assert (progress.stages, progress.done) == ([("projecting", 7)], [7])


def test_scans_that_were_rendered_are_not_rendered_again():
    drive = FaultyDrive(sample_drive(8), {2, 5})
    imager = Imager(SMALL_GRID, Reducer.MEAN)
    some = np.array([0, 1, 2, 4, 5])
    whole = project_drive(drive, np.arange(8), imager, most_probes=0)
    assert (len(whole), len(whole.probes)) == (6, 0)
    marked = replace(whole, images=MemoryImages(1.0 + whole.read(0, 6), SMALL_GRID))
    expected, found = (
        project_drive(drive, some, imager, rendered=rendered) for rendered in (None, marked)
    )
    np.testing.assert_array_equal(found.read(0, 3), 1.0 + expected.read(0, 3))
    np.testing.assert_array_equal(found.probes.read(0, 3), expected.probes.read(0, 3))
    assert found.skipped == expected.skipped
    assert (found.returns, len(found.probes)) == (expected.returns, 3)


def test_a_map_that_is_not_calibrated_makes_no_probes(monkeypatch):
    made = []
    monkeypatch.setattr("core.projection.images.probe_image", lambda *of: made.append(of))
    assert build([sample_drive(8)], MapParameters(ranks=(2, 2)), calibrated=False)
    assert not made
    build([sample_drive(8)], MapParameters(ranks=(2, 2)))
    assert len(made) == 8


def test_a_drive_without_a_usable_scan_is_rejected_with_the_first_reason():
    drive = FaultyDrive(sample_drive(3), {0, 1, 2})
    with pytest.raises(EmptyDrive, match="drive drive has no usable scan: scan 0: scan 0 is torn"):
        project_drive(drive, np.arange(3), Imager(SMALL_GRID, Reducer.LAST))
    numbered = AccumulatedDrive(drive, 2)
    with pytest.raises(EmptyDrive, match="no usable scan: scan 1: scan 0 is torn"):
        project_drive(numbered, np.arange(2), Imager(SMALL_GRID, Reducer.LAST))


def test_an_image_file_gives_back_the_images_of_the_drive(tmp_path):
    drive = FaultyDrive(sample_drive(20), {0, 9})
    nearest = Imager(SMALL_GRID, Reducer.NEAREST)
    expected = project_drive(drive, np.arange(20), nearest)
    progress = RecordedProgress()
    write_image_file(tmp_path / "images.h5", drive, nearest, progress)
    assert (progress.stages, progress.done) == ([("projecting", 20)], [20])
    with ImageFile(tmp_path / "images.h5", nearest) as images:
        assert len(images) == 18
        assert images.grid == SMALL_GRID
        np.testing.assert_array_equal(images.scans, expected.scans)
        assert images.skipped == expected.skipped
        assert images.returns == expected.returns
        for start, stop in ((0, 18), (0, 0), (7, 9), (17, 18)):
            read = images.read(start, stop)
            np.testing.assert_array_equal(read, expected.images.read(start, stop))
            assert read.dtype == np.float32
