"""Builds of drives: segments of the length that fits, and what a map says of its basis."""

from app.builds.drive_build import Built, build_drives
from app.builds.parameters import BuildParameters
from core.encodings.basis import BasisFit
from core.scans.drive import MemoryDrive
from core.scans.pose import Pose
from core.scans.scan import Scan
from tests.support.samples import sample_harmonic_map, sample_points


def test_a_scan_without_a_pose_does_not_change_the_length_of_segments():
    def segments(*unknown):
        scans = [
            Scan(sample_points(at), pose=None if at in unknown else Pose(2.0 * at, 0.0, 0.0))
            for at in range(110)
        ]
        built = build_drives([MemoryDrive("monday", scans)], BuildParameters(views="full"))
        return built.tensor_map.model.segment_start.tolist()

    assert segments() == segments(40) == segments(0, 109) == [0, 51, 110]
    assert segments(*range(110)) == [0, 110]  # of 100 scans, and the rest is too short for one


def test_a_basis_that_fits_a_drive_badly_is_noted():
    tensor_map, _ = sample_harmonic_map(8)
    fits = BasisFit("monday", 0.80, 0.70), BasisFit("tuesday", 0.71, 0.70)
    [note] = Built(tensor_map, 0, {}, fits, 8).notes
    assert "monday" in note
    assert "fit it anew" in note
