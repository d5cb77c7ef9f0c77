"""Builds of drives: segments of the length that fits, and what a map says of its basis."""

import errno
import tempfile

import numpy as np
import pytest

from app.builds.drive_build import Built, build_drives
from app.builds.parameters import BuildParameters
from core.encodings.basis import BasisFit
from core.scans.drive import MemoryDrive
from core.scans.pose import Pose
from core.scans.scan import Scan
from storage.errors import StorageFull
from tests.support.samples import sample_harmonic_map, sample_points


def test_a_scan_without_a_pose_does_not_change_the_length_of_segments():
    def segments(*unknown):
        scans = [
            Scan(sample_points(at), pose=None if at in unknown else Pose(2.0 * at, 0.0, 0.0))
            for at in range(110)
        ]
        built = build_drives([MemoryDrive("monday", scans)], BuildParameters(encoding="paper"))
        return built.tensor_map.model.segment_start.tolist()

    assert segments() == segments(40) == segments(0, 109) == [0, 51, 110]
    assert segments(*range(110)) == [0, 110]  # of 100 scans, and the rest is too short for one


def test_a_basis_that_fits_a_drive_badly_is_noted():
    tensor_map, _ = sample_harmonic_map(8)
    fits = BasisFit("monday", 0.80, 0.70), BasisFit("tuesday", 0.71, 0.70)
    *_, note = Built(tensor_map, 0, {}, fits, 8).notes
    assert "monday" in note
    assert "fit it anew" in note


@pytest.mark.parametrize(
    "parameters",
    [
        BuildParameters(encoding="paper", segments=1),
        BuildParameters(image="range", views="full", segments=1),
        BuildParameters(views="full", segments=1),
    ],
    ids=["paper", "harmonic of ranges", "harmonic of heights"],
)
def test_a_drive_with_returns_next_to_the_sensors_origin_is_built(parameters):
    def scan(at):
        points_m = sample_points(at)
        points_m[at] = 1e-40, 0.0, 0.0
        return Scan(points_m)

    only_such = Scan(np.full((30, 3), 1e-40, np.float32))
    built = build_drives(
        [MemoryDrive("monday", [*(scan(at) for at in range(6)), only_such])], parameters
    )
    is_of_heights = parameters.map_parameters().image == "height"
    assert len(built.tensor_map) == (7 if is_of_heights else 6), "the last has no range"


class Unreadable(MemoryDrive):
    """A drive with a file that belongs to another user."""

    def scan(self, index):
        if index == 3:
            raise PermissionError(errno.EACCES, "Permission denied", "monday/000003.bin")
        return super().scan(index)


def test_a_scan_that_cannot_be_read_is_named_and_is_no_fault_of_the_images():
    drive = Unreadable("monday", [Scan(sample_points(at)) for at in range(6)])
    with pytest.raises(PermissionError) as raised:
        build_drives([drive], BuildParameters(views="full", segments=1))
    assert raised.value.filename == "monday/000003.bin"


def test_where_the_temporary_folder_is_full_it_is_named_with_the_variable_that_moves_it(
    monkeypatch, tmp_path
):
    def full(*_of_all):
        raise StorageFull("no space is left") from OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr("app.builds.drive_build.write_image_file", full)
    drive = MemoryDrive("monday", [Scan(sample_points(at)) for at in range(6)])
    with pytest.raises(StorageFull, match="TMPDIR") as raised:
        build_drives([drive], BuildParameters(views="full", segments=1))
    assert str(tmp_path) in str(raised.value)
    assert not list(tmp_path.iterdir())
