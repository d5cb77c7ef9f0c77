"""Tracking on recorded drives: most places are reported, and no wrong one, stationary or moving."""

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest

from core.evaluation.condition import Condition
from core.evaluation.evaluate import EvaluationProtocol, evaluate
from core.evaluation.selected import SelectedScans
from core.evaluation.split import Interleaved
from core.evaluation.tracks import TrackResult
from core.localization.localizer import Localizer
from core.mapping.pipeline import build_map
from core.parameters import MapParameters
from core.scans.drive import Drive, MemoryDrive
from core.scans.scan import Scan
from core.tracking.track import Observation, Track, Tracker
from tests.support.recorded_drives import Drives

pytestmark = pytest.mark.real_data


def tracked(
    drives: Drives,
    encoding: str,
    segment_length: int,
    phase: int,
    conditions: tuple[Condition, ...] = (Condition(),),
) -> tuple[TrackResult, ...]:
    """Return the tracks along kit_muehlburger, by condition, in one map of it."""
    parameters, name = MapParameters.for_sensor(encoding=encoding), "kit_muehlburger"
    protocol = EvaluationProtocol(
        parameters,
        conditions=conditions,
        segment_length=segment_length,
        split=Interleaved(0.2, phase),
        track=True,
    )
    rendered = drives.rendered(name, parameters)
    return evaluate(drives.open(name), protocol, rendered=rendered).tracks


def require_right_segments(found: TrackResult) -> None:
    assert found.errors == ()
    assert found.first_fix is not None
    assert found.first_fix <= 5
    assert found.localized >= found.observations - 6
    assert found.segments_reported >= 0.88 * found.observations
    assert found.flicker == 0
    assert found.recall_at_1[3.0] == 1.0
    assert found.standing_found is not None
    assert found.standing_found >= 0.8


def require_right_segments_with_few_stops(found: TrackResult) -> None:
    """Of a track on which few stops of the vehicle are detected."""
    assert found.standing_found is not None
    assert found.standing_found < 0.5
    assert found.errors == ()
    assert found.segments_reported >= 0.9 * found.observations


@pytest.mark.parametrize(("segment_length", "phase"), [(50, 1), (100, 3), (167, 1)])
def test_no_wrong_segment_is_reported(drives: Drives, segment_length: int, phase: int) -> None:
    [found] = tracked(drives, "harmonic", segment_length, phase)
    require_right_segments(found)


def test_no_wrong_segment_is_reported_of_whole_scans_nor_of_those_with_a_third_hidden(
    drives: Drives,
) -> None:
    conditions = Condition(), Condition(disturb="hidden:120")
    whole, hidden = tracked(drives, "harmonic", 50, 2, conditions)
    require_right_segments(whole)
    require_right_segments_with_few_stops(hidden)


def test_no_wrong_segment_is_reported_in_the_papers_encoding(drives: Drives) -> None:
    [found] = tracked(drives, "paper", 50, 0)
    require_right_segments_with_few_stops(found)


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


@pytest.mark.parametrize("every", [3, 4])
def test_between_keyframes_five_or_seven_metres_apart_places_are_reported_and_none_is_wrong(
    drives: Drives, every: int
) -> None:
    drive = drives.open("kitti00")
    keyframes = np.arange(0, len(drive), every)
    mapped = drives.built("kitti00", keyframes, MapParameters.for_sensor(encoding="harmonic"))
    tracker = Tracker(Localizer(mapped))
    track, rows = Track(tracker), np.setdiff1d(np.arange(len(drive)), keyframes)
    steps = [track.observe(observed(tracker, drive.scan(row))) for row in rows.tolist()]
    apart_m = [
        float(np.linalg.norm(mapped.trajectory.poses[step.row, :3] - drive.poses[row, :3]))
        for row, step in zip(rows, steps, strict=True)
        if step.localized
    ]
    assert len(apart_m) >= 0.8 * len(steps)
    assert max(apart_m) <= 10.0
    assert sum(step.stationary for step in steps) <= 0.1 * len(steps)
    steps_m = np.linalg.norm(np.diff(drive.poses[:, :3], axis=0), axis=1)
    way_m = np.append(0.0, np.cumsum(steps_m))
    off_m = [
        abs(np.interp(step.position, np.arange(len(mapped)), way_m[keyframes]) - way_m[row])
        for row, step in zip(rows, steps, strict=True)
        if step.localized
    ]
    assert np.median(off_m) <= 0.6


@pytest.mark.parametrize("disturb", ["fov:120", "fov:90"])
def test_a_track_of_a_narrow_sensor_finds_more_places_than_its_observations_alone_and_no_wrong_one(
    drives: Drives, disturb: str
) -> None:
    drive = drives.open("kitti00")
    seen = Condition(disturb=disturb)
    scans = [seen.apply(drive.scan(row), np.random.default_rng(row)) for row in range(len(drive))]
    tracker = tracker_of_every_other_scan(MemoryDrive(drive.name, scans))
    track, alone, apart_m, rows = Track(tracker), 0, [], range(1, len(drive), 2)
    for row in rows:
        observation = observed(tracker, scans[row])
        step = track.observe(observation)
        alone += tracker.localizer.localize_signatures(observation.signatures).localized
        if step.localized:
            apart_m.append(tracker.map.trajectory.poses[step.row, :3] - drive.poses[row, :3])
    assert len(apart_m) >= alone >= 0.7 * len(rows)
    assert np.linalg.norm(apart_m, axis=1).max() <= 10.0


def test_a_vehicle_that_stands_in_another_town_with_a_covered_sensor_gets_no_place(
    drives: Drives,
) -> None:
    elsewhere = drives.open("kitti00")
    parameters, name = MapParameters.for_sensor(encoding="harmonic"), "kit_muehlburger"
    every_other = np.arange(0, len(drives.open(name)), 2)
    tracker = Tracker(Localizer(drives.built(name, every_other, parameters)))
    for row in range(0, len(elsewhere), 12):
        scan = elsewhere.scan(row)
        ahead = np.abs(np.arctan2(scan.points_m[:, 1], scan.points_m[:, 0])) < np.radians(120.0)
        track = Track(tracker)
        observation = observed(tracker, replace(scan, points_m=scan.points_m[ahead]))
        assert not any(track.observe(observation).localized for _ in range(25)), row


def test_after_a_lost_link_no_wrong_place_is_reported(drives: Drives) -> None:
    drive = drives.open("kitti00")
    parameters = MapParameters.for_sensor(encoding="harmonic")
    tracker = Tracker(Localizer(drives.built("kitti00", np.arange(len(drive)), parameters)))
    travelled_m = np.linalg.norm(np.diff(drive.poses[:, :3], axis=0), axis=1)
    rng = np.random.default_rng(1)

    @cache
    def beside(row: int) -> Observation:
        scan = drive.scan(row)
        noisy = scan.points_m - [0.9, 0.0, 0.0] + rng.normal(scale=0.1, size=scan.points_m.shape)
        return observed(tracker, replace(scan, points_m=noisy.astype(np.float32)))

    for known, start, gap in product(("time", "number", "odometry"), (0, 70, 140), (20, 30, 50)):
        track, last, right = Track(tracker), start, 0
        after = range(start + 12 + gap, start + 12 + gap + 10)
        for row in (*range(start, start + 12), *after):
            step = track.observe(
                replace(
                    beside(row),
                    sequence=row,
                    timestamp_s=0.1 * row if known == "time" else None,
                    travelled_m=travelled_m[last:row].sum() if known == "odometry" else None,
                )
            )
            last = row
            if row in after and step.localized:
                away_m = tracker.map.trajectory.poses[step.row, :3] - drive.poses[row, :3]
                assert np.linalg.norm(away_m) <= 10.0, (known, start, gap)
                right += 1
        assert right >= 4, (known, start, gap)
