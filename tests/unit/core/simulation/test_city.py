"""A city of which only the part around a vehicle is made."""

import numpy as np
import pytest

from core.scans.pose import Pose
from core.simulation import SimulatedDrive
from core.simulation.city import City
from core.simulation.raycast import SimulatedSensor, cast


def test_a_scan_is_the_same_as_in_the_whole_city():
    exact = SimulatedSensor(range_noise_m=0.0, dropout=0.0)
    drive = SimulatedDrive(seed=3, scans=1500, sensor=exact, lateral_offset_m=3.0)
    assert len(drive.world.buildings) > 1000
    for index in range(0, len(drive), 60):
        pose, time_s = Pose(*drive.poses[index].tolist()), float(drive.timestamp_s[index])
        scene = drive.world.at(time_s, around_m=(pose.x_m, pose.y_m), give_way_m=1.5)
        seen = cast(scene, pose, exact, np.random.default_rng(0))
        np.testing.assert_array_equal(drive.scan(index).points_m, seen.points_m)


@pytest.mark.parametrize("within_m", [0.0, 50.0, 300.0])
def test_a_part_of_a_city_has_all_that_is_near(within_m):
    city = City(5, 6, (6, 5))
    whole = city.whole()
    for x_m, y_m in [(0.0, 0.0), (150.0, 95.0), (-20.0, 400.0), (201.0, 128.0)]:
        part = city.around(x_m, y_m, within_m)
        for name in ("buildings", "parked"):
            solids = getattr(whole, name)
            near = solids.rows[solids.distance_m(x_m, y_m) <= within_m]
            found = {tuple(row) for row in getattr(part, name).rows.tolist()}
            assert {tuple(row) for row in near.tolist()} <= found
        assert len(part.buildings) < len(whole.buildings) or within_m == 300.0


def test_what_is_around_a_place_does_not_grow_with_the_city():
    assert 100 < len(City(1, 1, (1000, 1000)).around(9000.0, 9000.0, 120.0).buildings) < 2000


def test_a_drive_of_many_kilometres_makes_no_more_of_its_city_than_a_scan_sees(monkeypatch):
    made = []
    whole = City.part

    def counted(city, x_m, y_m):
        made.append(x_m[1] - x_m[0])
        return whole(city, x_m, y_m)

    monkeypatch.setattr(City, "part", counted)
    drive = SimulatedDrive(seed=1, scans=2, loop_m=20_000.0)
    assert len(drive.scan(1)) > 10_000
    assert len(made) == 1
    assert made[0] < 1000.0
