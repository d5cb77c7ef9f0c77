"""Vehicles whose sensor sees 120 degrees, in a map of it whose scans are far apart."""

import functools
from dataclasses import replace

import numpy as np
import pytest

from core.localization.localizer import Localizer
from core.mapping.pipeline import build_map
from core.parameters import MapParameters
from core.scans.drive import MemoryDrive
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from core.tracking.track import Observation, Track, Tracker

SCANS = 80
STEP_M = 3.6


@functools.cache
def drive(seed, step_m=STEP_M, **options):
    """Return a drive of a sensor that sees 120 degrees."""
    simulated = SimulatedDrive(
        seed=seed,
        scans=SCANS,
        speed_m_s=10.0 * step_m,
        stops=False,
        sensor=SimulatedSensor(firings=180),
        **options,
    )

    def ahead(scan):
        azimuth_deg = np.degrees(np.arctan2(scan.points_m[:, 1], scan.points_m[:, 0]))
        return replace(scan, points_m=scan.points_m[np.abs(azimuth_deg) < 60.0])

    return MemoryDrive(simulated.name, [ahead(scan) for scan in simulated])


@pytest.fixture(scope="module", params=[941, 942])
def tracker(request):
    # Observations are signatures: they are found without images, which a build calibrates too.
    parameters = MapParameters.for_sensor(encoding="harmonic", verification_images=False)
    return Tracker(Localizer(build_map(drive(request.param), parameters)))


def signatures_of(tracker, scans):
    basis = tracker.localizer.basis
    return [basis.encode(basis.image(scan)) for scan in scans]


def test_once_it_is_found_a_track_has_more_places_than_single_observations_and_no_wrong_one(
    tracker,
):
    mapped_m = tracker.map.trajectory.poses[:, :3]
    seed = int(tracker.map.trajectory.drives[0].removeprefix("simulated-"))
    again = drive(seed, noise_seed=seed, traffic_seed=seed + 1, lateral_offset_m=1.5)
    driven = signatures_of(tracker, again)
    track = Track(tracker)
    steps = [track.observe(Observation(signatures)) for signatures in driven]
    alone = np.array([tracker.localizer.localize_signatures(one).localized for one in driven])
    apart_m = np.linalg.norm(mapped_m[[step.row for step in steps]] - again.poses[:, :3], axis=1)
    localized = np.array([step.localized for step in steps])
    first = int(localized.argmax())
    assert 0 < first <= 20
    assert localized[first:].sum() >= max(alone[first:].sum(), SCANS // 2)
    assert (apart_m[localized] < 10.0).all()


@pytest.mark.parametrize("step_m", [STEP_M, 1.0, 0.5])
def test_it_finds_none_in_another_city_however_slowly_the_vehicle_drives(tracker, step_m):
    track = Track(tracker)
    driven = signatures_of(tracker, drive(943, step_m=step_m))
    assert not any(track.observe(Observation(signatures)).localized for signatures in driven)
