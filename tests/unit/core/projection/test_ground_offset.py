"""The ground of a drive is where its mounting has it, or elsewhere."""

import numpy as np
import pytest

from core.errors import InvalidScan
from core.projection.ground_offset import find_ground_offset
from core.scans.drive import MemoryDrive
from core.scans.mounting import Mounting
from core.scans.scan import Scan
from core.simulation import SimulatedDrive

HEIGHT_M = 1.73
STREET = MemoryDrive("street", list(SimulatedDrive(seed=5, scans=10)))


def recorded_by(mounting, drive=STREET):
    """Return a drive as a sensor records it that is tilted on its vehicle."""
    to_vehicle = Mounting(0.0, 0.0, HEIGHT_M, pitch_deg=-mounting.pitch_deg)
    return MemoryDrive("tilted", [Scan(to_vehicle.mount(s, HEIGHT_M).points_m) for s in drive])


@pytest.mark.parametrize("pitch_deg", [25.0, -25.0])
def test_a_level_sensor_with_a_pitch_in_its_mounting_is_found(pitch_deg):
    mounting = Mounting(0.0, 0.0, HEIGHT_M, pitch_deg=pitch_deg)
    found = find_ground_offset(STREET, mounting, HEIGHT_M)
    assert found is not None
    assert found.tilt_deg == pytest.approx(25.0, abs=2.0)
    assert (found.height_m, found.of_scans) == (None, 10)
    assert found.scans >= 8


@pytest.mark.parametrize(
    ("mounting", "height_m"), [(Mounting(0.0, 0.0, 6.0), HEIGHT_M), (None, 5.0)]
)
def test_a_height_that_is_not_the_sensors_is_found_with_the_right_one(mounting, height_m):
    found = find_ground_offset(STREET, mounting, height_m)
    assert found is not None
    assert found.tilt_deg is None
    assert found.height_m == pytest.approx(HEIGHT_M, abs=0.2)


@pytest.mark.parametrize("height_m", [0.9, HEIGHT_M, 2.8])
@pytest.mark.parametrize("pitch_deg", [0.0, 5.0])
def test_what_levelling_mends_is_not_noted(height_m, pitch_deg):
    assert find_ground_offset(STREET, None, height_m) is None
    mounting = Mounting(1.0, 0.5, height_m, pitch_deg=pitch_deg, yaw_deg=70.0)
    assert find_ground_offset(STREET, mounting, HEIGHT_M) is None


@pytest.mark.parametrize("pitch_deg", [20.0, 40.0])
def test_a_sensor_that_is_tilted_as_its_mounting_says_is_not_noted(pitch_deg):
    mounting = Mounting(0.0, 0.0, HEIGHT_M, pitch_deg=pitch_deg)
    assert find_ground_offset(recorded_by(mounting), mounting, HEIGHT_M) is None


def test_another_axis_that_is_up_has_its_own_note():
    assert find_ground_offset(STREET, Mounting(0, 0, HEIGHT_M, roll_deg=180.0), HEIGHT_M) is None


def test_a_drive_without_ground_and_one_of_two_scans_are_not_noted():
    above = [Scan.from_returns(s.points_m[s.points_m[:, 2] > 0.5]) for s in STREET]
    assert find_ground_offset(MemoryDrive("above", above), None, 5.0) is None
    assert find_ground_offset(MemoryDrive("two", list(STREET)[:2]), None, 5.0) is None


def test_scans_that_cannot_be_read_are_passed_over():
    class Broken(MemoryDrive):
        def scan(self, index):
            if index % 2:
                raise InvalidScan("damaged")
            return super().scan(index)

    found = find_ground_offset(Broken("broken", list(STREET)), None, 5.0)
    assert found is not None
    assert found.of_scans == 5


def test_grounds_in_many_places_are_no_mounting():
    lifted = [
        Scan.from_returns(s.points_m + np.array([0.0, 0.0, up_m]))
        for s, up_m in zip(STREET, np.linspace(-1.0, 1.3, 10), strict=True)
    ]
    assert find_ground_offset(MemoryDrive("lift", lifted), None, 6.0) is None
