"""The ground is on one side of a sensor: z is up, or another axis is."""

import numpy as np
import pytest

from core.errors import InvalidScan
from core.projection.up_axis import UpAxis, find_other_up_axis, find_other_up_axis_of_scan
from core.scans.drive import MemoryDrive
from core.scans.mounting import Mounting, vehicle_drive
from core.scans.pose import Pose
from core.scans.scan import Scan
from core.simulation.drive import SimulatedDrive
from core.simulation.raycast import SimulatedSensor, cast
from core.simulation.world import Boxes, Scene

HEIGHT_M = 1.73
UP = {
    "-z": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    "+y": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    "-y": [[0, -1, 0], [0, 0, -1], [1, 0, 0]],  # a camera's
    "+x": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
    "-x": [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
}
"""The axes of a sensor in the vehicle's frame, as rows, by the one that is up."""
LOOKS_UP = SimulatedSensor(tuple(np.linspace(2.0, 60.0, 64)))


@pytest.fixture(scope="module")
def street():
    drive = SimulatedDrive(scans=6, seed=5)
    return MemoryDrive("street", list(drive))


def turned(drive, rows):
    axes = np.array(rows, np.float64)
    scans = [Scan.from_returns(drive.scan(at).points_m @ axes.T) for at in range(len(drive))]
    return MemoryDrive("turned", scans)


def hall(sensor):
    """Return a drive below a ceiling 3 m high, between walls; the lane under it is open."""
    roof = [[x, side * 10.5, 0, 12, 20, 3.0, 3.5] for x in range(-30, 31, 12) for side in (-1, 1)]
    walls = [[0, side * 20.5, 0, 80, 1, 0, 3.5] for side in (-1, 1)]
    ends = [[side * 40.5, 0, 90, 42, 1, 0, 3.5] for side in (-1, 1)]
    scene = Scene(Boxes([*roof, *walls, *ends]))
    rng = np.random.default_rng(1)
    poses = [Pose(float(x), 0, HEIGHT_M, 0, 0, 0, 1) for x in range(-4, 5, 2)]
    return MemoryDrive("hall", [cast(scene, pose, sensor, rng) for pose in poses])


@pytest.mark.parametrize("height_m", [HEIGHT_M, 0.9, 3.0])
def test_of_a_level_sensor_nothing_is_said(street, height_m):
    assert find_other_up_axis(street, height_m) is None


@pytest.mark.parametrize("axis", UP)
def test_another_axis_that_is_up_is_found_and_its_angle_turns_it_up(street, axis):
    wrong = turned(street, UP[axis])
    assert find_other_up_axis(wrong, HEIGHT_M) == UpAxis(axis, 6, 6)
    name, angle_deg = UpAxis(axis, 6, 6).angle_deg
    mounting = Mounting(0.0, 0.0, HEIGHT_M, **{name: angle_deg})
    mounted = vehicle_drive(wrong, mounting, HEIGHT_M)
    assert find_other_up_axis(mounted, HEIGHT_M) is None


@pytest.mark.parametrize("sensor", [SimulatedSensor(), LOOKS_UP])
def test_a_ceiling_is_not_taken_for_the_ground(sensor):
    assert find_other_up_axis(hall(sensor), HEIGHT_M) is None


def test_the_cone_of_a_sensor_that_hardly_looks_up_is_not_taken_for_the_ground():
    """Its highest returns, from houses around it, are nearly in a plane; below them are cars."""
    rng = np.random.default_rng(1)
    azimuth, far_m = np.radians(np.arange(0.0, 360.0, 0.5)), rng.uniform(16.0, 23.0, 720)
    up = np.radians(np.linspace(-3.0, 2.0, 12))[:, None]
    z_m = far_m * np.tan(up)
    x_m, y_m = far_m * np.cos(azimuth), far_m * np.sin(azimuth)
    seen = up > np.radians(rng.uniform(-3.0, 0.0, 720))
    around_m = np.stack(np.broadcast_arrays(x_m, y_m, z_m), axis=-1)[seen]
    scan = Scan.from_returns(around_m)
    assert find_other_up_axis_of_scan(scan.points_m, HEIGHT_M) is None
    assert find_other_up_axis(MemoryDrive("courtyard", [scan] * 4), HEIGHT_M) is None


def test_a_sensor_that_hangs_in_a_hall_is_found():
    assert find_other_up_axis(turned(hall(SimulatedSensor()), UP["-z"]), HEIGHT_M) is not None


def test_a_drive_without_ground_gives_no_answer(street):
    above = [street.scan(at).points_m for at in range(len(street))]
    scans = [Scan.from_returns(points_m[points_m[:, 2] > 0.5]) for points_m in above]
    assert find_other_up_axis(MemoryDrive("above", scans), HEIGHT_M) is None


def test_scans_that_cannot_be_read_are_passed_over(street):
    class Broken(MemoryDrive):
        def scan(self, index):
            if index > 1:
                raise InvalidScan("damaged")
            return super().scan(index)

    wrong = turned(street, UP["-z"])
    scans = [wrong.scan(at) for at in range(len(wrong))]
    assert find_other_up_axis(Broken("broken", scans), HEIGHT_M) is None  # of too few


@pytest.mark.parametrize("height_m", [HEIGHT_M, 0.9, 3.0])
def test_of_one_level_scan_nothing_is_said(street, height_m):
    for at in range(len(street)):
        assert find_other_up_axis_of_scan(street.scan(at).points_m, height_m) is None


@pytest.mark.parametrize("axis", UP)
def test_another_axis_that_is_up_is_found_in_one_scan(street, axis):
    wrong = turned(street, UP[axis])
    for at in range(len(wrong)):
        assert find_other_up_axis_of_scan(wrong.scan(at).points_m, HEIGHT_M) == UpAxis(axis, 1, 1)


def test_one_scan_below_a_ceiling_or_without_ground_gives_no_answer(street):
    for drive in (hall(SimulatedSensor()), hall(LOOKS_UP)):
        assert find_other_up_axis_of_scan(drive.scan(2).points_m, HEIGHT_M) is None
    above = street.scan(0).points_m
    assert find_other_up_axis_of_scan(above[above[:, 2] > 0.5], HEIGHT_M) is None
    assert find_other_up_axis_of_scan(above[:1], HEIGHT_M) is None
    assert find_other_up_axis_of_scan(above[:0], HEIGHT_M) is None
    assert find_other_up_axis_of_scan(np.float32(3e38) * np.sign(above), HEIGHT_M) is None
