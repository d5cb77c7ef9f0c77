"""Tracking on recorded drives: most places are reported, and no wrong one, stationary or moving."""

from dataclasses import replace

import numpy as np
import pytest

from core.evaluation.evaluate import EvaluationProtocol, evaluate
from core.evaluation.selected import SelectedScans
from core.evaluation.split import Interleaved
from core.localization.localizer import Localizer
from core.mapping.pipeline import build_map
from core.parameters import MapParameters
from core.scans.drive import Drive
from core.scans.scan import Scan
from core.tracking.track import Observation, Track, Tracker
from tests.support.recorded_drives import Drives

pytestmark = pytest.mark.real_data


@pytest.mark.parametrize(("segment_length", "phase"), [(50, 1), (50, 2), (100, 3), (167, 1)])
def test_no_wrong_segment_is_reported(drives: Drives, segment_length: int, phase: int) -> None:
    protocol = EvaluationProtocol(
        MapParameters.for_sensor(encoding="harmonic"),
        segment_length=segment_length,
        split=Interleaved(0.2, phase),
        track=True,
    )
    [found] = evaluate(drives.open("kit_muehlburger"), protocol).tracks
    assert found.errors == ()
    assert found.first_fix is not None
    assert found.first_fix <= 5
    assert found.localized >= found.observations - 6
    assert found.segments_reported >= 0.88 * found.observations
    assert found.flicker == 0
    assert found.recall_at_1[3.0] == 1.0
    assert found.standing_found is not None
    assert found.standing_found >= 0.8


def tracker_of_every_other_scan(drive: Drive) -> Tracker:
    mapped = SelectedScans(drive, np.arange(0, len(drive), 2))
    return Tracker(Localizer(build_map(mapped, MapParameters.for_sensor(encoding="harmonic"))))


def observed(tracker: Tracker, scan: Scan) -> Observation:
    return Observation(tracker.localizer.basis.encode(tracker.localizer.basis.image(scan)))


def test_on_a_street_that_is_alike_along_itself_most_places_are_reported_and_none_is_wrong(
    drives: Drives,
) -> None:
    drive = drives.open("nclt_turn")
    tracker = tracker_of_every_other_scan(drive)
    track, rows = Track(tracker), range(1, len(drive), 2)
    steps = [track.observe(observed(tracker, drive.scan(row))) for row in rows]
    apart_m = [
        tracker.map.trajectory.poses[step.row, :3] - drive.poses[row, :3]
        for row, step in zip(rows, steps, strict=True)
        if step.localized
    ]
    assert len(apart_m) >= 0.6 * len(steps)
    assert np.linalg.norm(apart_m, axis=1).max() <= 10.0


def test_a_vehicle_that_stands_in_another_town_with_a_covered_sensor_gets_no_place(
    drives: Drives,
) -> None:
    elsewhere = drives.open("kitti00")
    tracker = tracker_of_every_other_scan(drives.open("kit_muehlburger"))
    for row in range(0, len(elsewhere), 12):
        scan = elsewhere.scan(row)
        ahead = np.abs(np.arctan2(scan.points_m[:, 1], scan.points_m[:, 0])) < np.radians(120.0)
        track = Track(tracker)
        observation = observed(tracker, replace(scan, points_m=scan.points_m[ahead]))
        assert not any(track.observe(observation).localized for _ in range(25)), row
