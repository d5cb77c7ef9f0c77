"""Tracks whose odometry is wrong: scans that are surely elsewhere leave them no certain place."""

from types import SimpleNamespace

import numpy as np
import pytest

from core.localization.localizer import Localizer
from core.mapping.pipeline import build_map
from core.parameters import MapParameters
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from core.tracking.contradiction import contradicts
from core.tracking.track import Observation, Track, Tracker
from tests.support.samples import calibrated_map, own_signatures, sample_map

SCANS, EVERY = 80, 2


def drive(**options):
    sensor = SimulatedSensor(firings=180)
    return SimulatedDrive(seed=4, scans=SCANS, sensor=sensor, stops=False, **options)


@pytest.fixture(scope="module")
def driven():
    """Return the tracker of a street, and signatures and poses of a second pass."""
    parameters = MapParameters.for_sensor(encoding="harmonic", verification_images=False)
    tracker = Tracker(Localizer(build_map(drive(), parameters)))
    again, basis = drive(noise_seed=9, lateral_offset_m=1.0), tracker.localizer.basis
    rows = range(0, SCANS, EVERY)
    signatures = [basis.encode(basis.image(again.scan(row))) for row in rows]
    return SimpleNamespace(tracker=tracker, signatures=signatures, poses=again.poses[::EVERY])


def errors_m(driven, travelled_m):
    """Return how far off each place is that is reported with such odometry."""
    track, mapped_m, found = Track(driven.tracker), driven.tracker.map.trajectory.poses[:, :3], []
    for signatures, pose, metres in zip(driven.signatures, driven.poses, travelled_m, strict=True):
        step = track.observe(Observation(signatures, travelled_m=metres))
        if step.localized:
            found.append(float(np.linalg.norm(mapped_m[step.row] - pose[:3])))
    return found


def test_with_odometry_that_is_always_0_in_feet_or_in_kilometres_no_place_is_far_off(driven):
    ways_m = np.linalg.norm(
        np.diff(driven.poses[:, :3], axis=0, prepend=driven.poses[:1, :3]), axis=1
    )
    for factor in (0.0, 0.001, 3.28):
        assert max(errors_m(driven, factor * ways_m), default=0.0) <= 10.0, factor
    assert max(errors_m(driven, np.cumsum(ways_m)), default=0.0) <= 10.0
    right = errors_m(driven, ways_m)
    assert len(right) == len(ways_m) - 2
    assert max(right) <= 3.0


@pytest.mark.parametrize(("row", "expected"), [(30, False), (33, False), (90, True)])
def test_an_observation_contradicts_a_place_that_it_is_surely_away_from(row, expected):
    tensor_map = calibrated_map()
    search = tensor_map.model.search(own_signatures(tensor_map, 30))
    likelihood = 1.0 / (1.0 + search.distances())
    assert contradicts(tensor_map, search, likelihood, row) == expected
    assert not contradicts(tensor_map, search, np.ones(len(tensor_map)), row)


def test_without_a_calibration_nothing_is_contradicted():
    tensor_map, _ = sample_map(count=40, segment_length=10)
    search = tensor_map.model.search(own_signatures(tensor_map, 30))
    assert tensor_map.calibration is None
    assert not contradicts(tensor_map, search, 1.0 / (1.0 + search.distances()), 0)
