"""Vehicles where the map reaches and in another city: the first get a place, the others none.

One that stands repeats its observation: what makes it likely counts many times.
"""

from dataclasses import replace

import numpy as np
import pytest

from core.localization.localizer import Localizer
from core.mapping.pipeline import build_map
from core.parameters import MapParameters
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from core.tracking.track import Observation, Track, Tracker

SCANS = 80
OBSERVATIONS = 25


def drive(seed, **options):
    sensor = SimulatedSensor(firings=180)
    return SimulatedDrive(seed=seed, scans=SCANS, sensor=sensor, stops=False, **options)


@pytest.fixture(scope="module")
def tracker():
    # Observations are signatures: they are found without images, which a build calibrates too.
    parameters = MapParameters.for_sensor(encoding="harmonic", verification_images=False)
    return Tracker(Localizer(build_map(drive(3), parameters)))


def covered(scan, degrees):
    """Return the scan without the returns of so many degrees to the left of straight behind."""
    azimuth_deg = np.degrees(np.arctan2(scan.points_m[:, 1], scan.points_m[:, 0]))
    return replace(scan, points_m=scan.points_m[azimuth_deg < 180.0 - degrees])


def placed(tracker, scans, ranks=None):
    """Return how many vehicles that stand, one at each scan, get a place."""
    basis = tracker.localizer.basis
    count = 0
    for scan in scans:
        signatures, track = basis.encode(basis.image(scan), ranks), Track(tracker)
        count += any(track.observe(Observation(signatures)).localized for _ in range(OBSERVATIONS))
    return count


@pytest.mark.parametrize(("covered_deg", "at_most"), [(0.0, 1), (120.0, 2)])
def test_of_20_vehicles_that_stand_in_another_city_hardly_any_gets_a_place(
    tracker, covered_deg, at_most
):
    other = drive(78)
    scans = [covered(other.scan(row), covered_deg) for row in range(0, SCANS, 4)]
    assert placed(tracker, scans) <= at_most


def test_vehicles_that_send_fewer_numbers_get_a_place_in_the_map_and_none_in_another_city(tracker):
    other, again = drive(78), drive(3, noise_seed=9, lateral_offset_m=1.0)
    unknown = [other.scan(row) for row in range(0, SCANS, 4)]
    for ranks in ((5, 5), (4, 4)):
        assert placed(tracker, unknown, ranks) <= 1
    known = [again.scan(row) for row in range(0, SCANS, 8)]
    assert placed(tracker, known, (4, 4)) >= 0.8 * len(known)


@pytest.mark.parametrize("covered_deg", [0.0, 120.0])
def test_a_vehicle_that_stands_beside_the_map_s_line_gets_its_place(tracker, covered_deg):
    again = drive(3, noise_seed=9, lateral_offset_m=1.0)
    scans = [covered(again.scan(row), covered_deg) for row in range(0, SCANS, 8)]
    assert placed(tracker, scans) == len(scans)


def test_a_vehicle_that_drives_on_where_the_map_ends_loses_its_place_at_once_and_gets_it_back(
    tracker,
):
    basis, again = tracker.localizer.basis, drive(3, noise_seed=9, lateral_offset_m=1.0)
    other, track = drive(78), Track(tracker)

    def localized(of, rows):
        scans = (of.scan(row) for row in rows)
        signatures = (basis.encode(basis.image(scan)) for scan in scans)
        return [track.observe(Observation(of_scan)).localized for of_scan in signatures]

    assert all(localized(again, range(30))[5:])
    assert not any(localized(other, range(30))[3:])
    assert all(localized(again, range(30, 50))[10:])
