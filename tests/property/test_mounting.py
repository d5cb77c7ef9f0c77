"""The laws of mountings and accumulation: poses are inverted, and the world stays where it is."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from core.scans.accumulation import accumulate
from core.scans.mounting import Mounting
from core.scans.pose import Pose
from core.scans.scan import Scan
from tests.support.samples import sample_points

metres = st.floats(-50.0, 50.0)
degrees = st.floats(-360.0, 360.0)
mountings = st.builds(Mounting, metres, metres, st.floats(0.01, 99.0), degrees, degrees, degrees)
rotations = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1)


@st.composite
def pose_rows(draw, count):
    rows = [
        [*draw(st.tuples(*[metres] * 3)), *Rotation.from_quat(draw(rotations)).as_quat()]
        for _ in range(count)
    ]
    return np.array(rows)


def in_world(row, points_m):
    return Rotation.from_quat(row[3:]).apply(points_m.astype(np.float64)) + row[:3]


@given(mountings, pose_rows(3))
def test_sensor_and_vehicle_poses_are_each_others_inverse(mounting, rows):
    for there, back in (
        (mounting.vehicle_poses, mounting.sensor_poses),
        (mounting.sensor_poses, mounting.vehicle_poses),
    ):
        again = back(there(rows))
        np.testing.assert_allclose(again[:, :3], rows[:, :3], atol=1e-9)
        turned = Rotation.from_quat(again[:, 3:]).inv() * Rotation.from_quat(rows[:, 3:])
        assert turned.magnitude().max() < 1e-7


@given(mountings, pose_rows(1), st.floats(0.1, 10.0))
def test_mounted_returns_are_where_they_were_in_the_world(mounting, rows, above_ground_m):
    scan = Scan(sample_points(1), pose=Pose.from_row(rows[0]))
    mounted = mounting.mount(scan, above_ground_m)
    vehicle = np.array(mounted.pose.as_tuple())
    lifted = mounted.points_m + np.array([0.0, 0.0, above_ground_m])
    np.testing.assert_allclose(
        in_world(vehicle, lifted), in_world(rows[0], scan.points_m), atol=1e-4
    )


@given(mountings, pose_rows(1))
def test_accumulating_and_mounting_give_one_scan_in_either_order(mounting, rows):
    """The vehicle's odometry composes with the mounting to the sensor's."""
    step = Rotation.from_euler("xyz", [1.0, -2.0, 20.0], degrees=True)
    last = np.concatenate([rows[0, :3] + [3.0, -1.0, 0.2], (step * turned(rows[0])).as_quat()])
    vehicle = np.array([rows[0], last])
    scans = [Scan(sample_points(seed)) for seed in (1, 2)]
    first = mounting.mount(accumulate(scans, mounting.sensor_poses(vehicle)), 1e-9)
    on_the_ground = [mounting.mount(scan, 1e-9) for scan in scans]
    second = accumulate(on_the_ground, vehicle)
    np.testing.assert_allclose(first.points_m, second.points_m, atol=1e-4)


def turned(row):
    return Rotation.from_quat(row[3:])


@given(pose_rows(1), pose_rows(2))
def test_accumulation_does_not_depend_on_the_frame_of_its_poses(frame, rows):
    """Odometry may begin anywhere, in any direction."""
    rows[:, :3] *= 0.3
    scans = [Scan(sample_points(seed)) for seed in (1, 2)]
    moved = rows.copy()
    moved[:, :3] = in_world(frame[0], rows[:, :3])
    moved[:, 3:] = (turned(frame[0]) * Rotation.from_quat(rows[:, 3:])).as_quat()
    np.testing.assert_allclose(
        accumulate(scans, rows).points_m, accumulate(scans, moved).points_m, atol=1e-4
    )
