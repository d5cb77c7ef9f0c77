"""The mounting of a sensor, and drives in the vehicle's frame."""

import numpy as np
import pytest

from core.errors import InvalidParameters
from core.scans.drive import IndexedDrive
from core.scans.mounting import MountedDrive, Mounting, vehicle_drive
from core.scans.pose import Pose
from core.scans.scan import Scan
from tests.support.samples import sample_drive, sample_points, straight_poses

ROOF = Mounting(1.2, -0.4, 1.9, 2.0, 7.0, 120.0)


def seen(*returns_m):
    return Scan.from_returns(np.array(returns_m))


@pytest.mark.parametrize(
    ("angles", "ahead"),
    [
        ({"yaw_deg": 90.0}, [0.0, 10.0, 0.0]),  # to the left
        ({"pitch_deg": 90.0}, [0.0, 0.0, -10.0]),  # down
        ({"roll_deg": 90.0}, [10.0, 0.0, 0.0]),
        ({"pitch_deg": 90.0, "yaw_deg": 90.0}, [0.0, 0.0, -10.0]),
    ],
)
def test_what_is_ahead_of_a_rotated_sensor_is_elsewhere_for_the_vehicle(angles, ahead):
    mounting = Mounting(0.0, 0.0, 1.5, **angles)
    mounted = mounting.mount(seen([10.0, 0.0, 0.0]), above_ground_m=1.5)
    np.testing.assert_allclose(mounted.points_m, [ahead], atol=1e-5)


def test_what_is_left_of_a_sensor_that_rolled_to_the_right_is_above():
    mounting = Mounting(0.0, 0.0, 1.5, roll_deg=90.0)
    mounted = mounting.mount(seen([0.0, 10.0, 0.0]), above_ground_m=1.5)
    np.testing.assert_allclose(mounted.points_m, [[0.0, 0.0, 10.0]], atol=1e-5)


def test_the_ground_is_where_the_map_assumes_it():
    ground = seen([8.0, 0.0, -2.4])
    mounted = Mounting(0.5, 0.0, 2.4).mount(ground, above_ground_m=1.73)
    np.testing.assert_allclose(mounted.points_m, [[8.5, 0.0, -1.73]], atol=1e-6)


def test_a_sensor_at_the_vehicles_origin_changes_no_return():
    scan = Scan(sample_points(3), timestamp_s=4.0, pose=Pose(1.0, 2.0, 1.73))
    mounted = Mounting(0, 0, 1.73).mount(scan, above_ground_m=1.73)
    np.testing.assert_array_equal(mounted.points_m, scan.points_m)
    assert mounted.timestamp_s == 4.0
    assert mounted.pose == Pose(1.0, 2.0, 0.0)  # the vehicle's, which is on the ground


def test_an_unknown_pose_stays_unknown():
    rows = straight_poses(3)
    rows[1] = np.nan
    assert np.isnan(ROOF.vehicle_poses(rows)).all(axis=1).tolist() == [False, True, False]
    assert ROOF.mount(Scan(sample_points(0)), 1.73).pose is None


@pytest.mark.parametrize(
    ("numbers", "wanted"),
    [
        ((np.nan, 0.0, 1.0), "x_m is nan, wanted -50 to 50"),
        ((0.0, 51.0, 1.0), "y_m is 51.0, wanted -50 to 50"),
        ((0.0, 0.0, 0.0), "z_m is 0.0, wanted the height of the sensor above ground"),
        ((0.0, 0.0, np.nan), "z_m is nan"),
        ((0.0, 0.0, 100.0), "below 100"),
        ((0.0, 0.0, 1.0, 0.0, np.inf), "pitch_deg is inf, wanted -360 to 360"),
        ((0.0, 0.0, 1.0, 0.0, 0.0, -361.0), "yaw_deg is -361.0"),
    ],
)
def test_a_number_out_of_its_range_is_named(numbers, wanted):
    with pytest.raises(InvalidParameters, match=wanted):
        Mounting(*numbers)


def test_a_mounting_is_read_from_its_text():
    assert Mounting.from_text("1.2,-0.4,1.9,2,7,120") == ROOF
    assert Mounting.from_text(str(ROOF)) == ROOF
    assert Mounting.from_text(" 1, 0, 2") == Mounting(1.0, 0.0, 2.0)


@pytest.mark.parametrize(
    "text", ["", "1,2", "1,2,x", "1,0,1,0", "1,0,1,0,90", "1,0,1,0,0,0,0", "1;0;1"]
)
def test_another_text_is_no_mounting(text):
    with pytest.raises(InvalidParameters, match="wanted x,y,z,roll,pitch,yaw"):
        Mounting.from_text(text)


def test_a_mounted_drive_has_the_scans_and_poses_of_the_vehicle():
    drive = sample_drive(4)
    mounted = MountedDrive(drive, ROOF, 1.73)
    assert isinstance(mounted, IndexedDrive)
    assert (len(mounted), mounted.name, mounted.scan_index.tolist()) == (4, "drive", [0, 1, 2, 3])
    np.testing.assert_array_equal(mounted.timestamp_s, drive.timestamp_s)
    scan = mounted.scan(2)
    np.testing.assert_array_equal(scan.points_m, ROOF.mount(drive.scan(2), 1.73).points_m)
    assert scan.pose is not None
    np.testing.assert_allclose(scan.pose.as_tuple(), mounted.poses[2])


def test_a_drive_without_a_mounting_is_itself():
    drive = sample_drive(3)
    assert vehicle_drive(drive, None, 1.73) is drive


def test_the_dropped_returns_of_a_scan_are_those_of_the_mounted_one_too():
    scan = Scan.from_returns(np.concatenate([np.zeros((5, 3)), np.ones((3, 3))]))
    mounted = Mounting(0.5, 0.0, 2.0, 1.0, 2.0, 3.0).mount(scan, 1.8)
    assert (len(mounted), mounted.dropped_returns) == (3, 5)
