"""Metres along the drives of a map, some of whose scans have no pose, and its segments."""

import itertools
import math
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest

from core.encodings.distance import Distance
from core.errors import InvalidParameters
from core.localization.localizer import Localizer
from core.mapping.fit import fit_map
from core.parameters import MapParameters
from core.projection.images import MemoryImages
from core.projection.reducer import Reducer
from core.projection.rings import RingGrid
from core.topology import cut_at_meetings, join_segments
from core.tracking.graph import TravelGraph, _directions, _positions_m
from core.tracking.track import Observation, Track, Tracker
from tests.support.samples import (
    observed,
    own_signatures,
    random_images,
    sample_harmonic_map,
    sample_map,
    straight_poses,
    trajectory,
    without_poses,
)


def two_drives(*unposed):
    """Return a map of two drives of 40 scans each, a metre apart, some of them without a pose."""
    return without_poses(sample_harmonic_map(40, 10, drives=2)[0], *unposed)


def test_a_scan_without_a_pose_is_evenly_between_its_neighbours():
    whole, gap = TravelGraph.of_map(two_drives()), TravelGraph.of_map(two_drives(2))
    np.testing.assert_allclose(gap.along_m, whole.along_m)
    np.testing.assert_allclose(gap.strides.ahead_m, whole.strides.ahead_m)


def test_metres_are_unknown_only_where_scans_without_a_pose_have_none_near_on_both_sides():
    many = range(10, 20)
    along_m = TravelGraph.of_map(two_drives(0, *many, 39, 40, 79)).along_m
    unknown = np.isin(np.arange(80), [0, *many, 39, 40, 79])
    assert np.isnan(along_m[unknown]).all()
    steps_m = np.diff(along_m)
    beside = unknown[1:] | unknown[:-1]
    np.testing.assert_allclose(steps_m[~beside], 1.0)


def test_a_drive_without_poses_leaves_the_lengths_of_the_next_one_known():
    graph = TravelGraph.of_map(two_drives(*range(40)))
    assert np.isnan(graph.along_m[:40]).all()
    np.testing.assert_allclose(np.diff(graph.along_m[40:]), 1.0)


def test_after_one_scan_without_a_pose_answers_have_metres():
    tracker = Tracker(Localizer(two_drives(2)))
    for rows in (range(8), range(45, 53)):
        track = Track(tracker)
        steps = [track.observe(Observation(own_signatures(tracker.map, row))) for row in rows]
        assert all(step.along_sigma_m is not None for step in steps)


def test_the_way_from_one_drive_to_the_next_that_goes_on_there_has_its_metres():
    apart = two_drives()
    poses = apart.trajectory.poses.copy()
    poses[:, 1:3] = 0.0
    poses[:, 0] = np.arange(80.0)
    poses[40:, 0] += 9.0
    trajectory = replace(apart.trajectory, poses=poses)
    topology = join_segments(trajectory, apart.model.segment_start)
    graph = TravelGraph.of_map(replace(apart, trajectory=trajectory, topology=topology))
    along, against = graph.strides.ahead_m[::2], graph.strides.ahead_m[1::2]
    assert (along[39], against[40]) == (10.0, 10.0)
    np.testing.assert_allclose(np.delete(along[:-1], 39), 1.0)
    np.testing.assert_allclose(np.delete(against[1:], 39), 1.0)
    assert (along[-1], against[0]) == (0.0, 0.0)
    assert graph.along_m[[39, 40]].tolist() == [39.0, 39.0]


def joined_drives(*poses, segment_length=40):
    """Return a map of drives of metres, cut where they meet."""
    drives = trajectory(*poses)
    starts = [range(a, b, segment_length) for a, b in itertools.pairwise(drives.drive_start)]
    cut = cut_at_meetings(drives, np.array([*itertools.chain(*starts), len(drives)]))
    grid = RingGrid(ring_m=10.0, rings=6, azimuth_step_deg=20.0)
    images = random_images(len(drives), grid.shape)[:, None]
    parameters = MapParameters(
        "harmonic", (3, 4), Reducer.MEAN, "hdl-64e", grid, 1.73, Distance.NORMALISED, (0.0,)
    )
    return fit_map(MemoryImages(images, grid), drives, cut, parameters)


def lane(count, beside_m, *, against=False, sensor_deg=0.0):
    """Return the poses of a drive in a street along x."""
    poses = straight_poses(count)
    poses[:, 1] = beside_m
    yaw = math.radians(sensor_deg + 180.0 * against)
    poses[:, 5:] = math.sin(yaw / 2.0), math.cos(yaw / 2.0)
    return poses[::-1].copy() if against else poses


@pytest.mark.parametrize("beside_m", [3.0, 6.0])
@pytest.mark.parametrize("given", [{}, {"against": True}, {"sensor_deg": 90.0}])
def test_the_way_to_a_lane_beside_is_what_is_driven_ahead(beside_m, given):
    other = lane(200, beside_m, **given)
    other[:, 0] += 0.4
    mapped = joined_drives(lane(200, 0.0, **given | {"against": False}), other)
    assert mapped.topology.edges < len(mapped.model.segment_start) - 1  # they share a street
    graph = TravelGraph.of_map(mapped)
    row = np.arange(200)
    inner = (row > 2) & (row < 197)  # at the ends of the street there is less ahead
    for of_drive in (slice(0, 200), slice(200, 400)):
        for ahead_m in (graph.strides.ahead_m[::2], graph.strides.ahead_m[1::2]):
            np.testing.assert_allclose(ahead_m[of_drive][inner], 1.0, atol=0.71)


def test_a_drive_that_begins_beside_the_end_of_another_one_is_reached_on_a_way_of_no_length():
    ahead = lane(120, 3.0)
    ahead[:, 0] += 79.0  # beside the last scan but one of a drive of 81
    mapped = joined_drives(lane(81, 0.0), ahead)
    graph = TravelGraph.of_map(mapped)
    assert graph.strides.ahead.sum(axis=0) == pytest.approx(1.0)
    assert np.isfinite(graph.walks.length_m).all()
    tracker = Tracker(Localizer(mapped))
    track = Track(tracker)
    rows = [*range(70, 81), *range(83, 95)]
    steps = [track.observe(observed(tracker, row, travelled_m=1.0)) for row in rows]
    assert all(step.localized for step in steps[4:])
    reached_m = mapped.trajectory.poses[[step.row for step in steps[4:]], 0]
    np.testing.assert_allclose(reached_m, mapped.trajectory.poses[rows[4:], 0])


def test_where_drives_cross_the_way_round_the_corner_is_its_chord():
    crossing = lane(60, 0.0)
    crossing[:, 1], crossing[:, 0] = crossing[:, 0] - 29.5, 29.5
    graph = TravelGraph.of_map(joined_drives(lane(60, 0.0), crossing, segment_length=60))
    before = 2 * 29
    entered = graph.strides.ahead[:, [before]].nonzero()[0]
    assert set(entered.tolist()) == {2 * 30, 2 * 90, 2 * 89 + 1}  # straight on, left and right
    chord_m = math.hypot(0.5, 0.5)
    assert graph.strides.ahead_m[before] == pytest.approx((1.0 + 2.0 * chord_m) / 3.0)


def test_the_way_to_a_lane_beside_is_known_where_scans_at_a_joint_have_no_pose():
    mapped = joined_drives(lane(200, 0.0), lane(200, 6.0))
    starts = mapped.model.segment_start[1:-1]
    inner = starts[(starts % 200 > 2) & (starts % 200 < 197)]
    graph = TravelGraph.of_map(without_poses(mapped, *inner, *(inner - 1)))
    whole = TravelGraph.of_map(mapped)
    np.testing.assert_allclose(graph.strides.ahead_m, whole.strides.ahead_m, atol=1e-9)


def map_with_a_stand(segment_length, *crossing):
    """Return a map whose vehicle drove 20 m, stood for 560 scans and drove 20 m more.

    Args:
        segment_length: Of that drive.
        crossing: The poses of a second drive of two segments.
    """
    poses = straight_poses(600)
    poses[:, 0] = [*range(20), *[20.0] * 560, *range(21, 41)]
    drives = trajectory(poses, *crossing)
    starts = [*range(0, 600, segment_length), 600]
    starts += [600 + len(crossing[0]) // 2, 600 + len(crossing[0])] if crossing else []
    grid = RingGrid(ring_m=10.0, rings=6, azimuth_step_deg=20.0)
    images = random_images(len(drives), grid.shape)[:, None]
    images[20:580] = images[20] + random_images(560, grid.shape, seed=1)[:, None] / 50.0
    parameters = MapParameters(
        "harmonic", (3, 4), Reducer.MEAN, "hdl-64e", grid, 1.73, Distance.NORMALISED, (0.0,)
    )
    return fit_map(MemoryImages(images, grid), drives, np.array(starts), parameters)


@pytest.mark.parametrize("segment_length", [600, 70])
@pytest.mark.parametrize(("begin", "direction", "reached"), [(19, 0, 581), (580, 1, 18)])
def test_a_step_leads_out_of_a_stand_in_both_directions(segment_length, begin, direction, reached):
    graph = TravelGraph.of_map(map_with_a_stand(segment_length))
    at = np.zeros(graph.places)
    at[2 * begin + direction] = 1.0
    for _ in range(3):
        at = np.asarray(graph.strides.ahead @ at)
    assert at[2 * reached + direction] == pytest.approx(1.0)
    assert graph.walks.length_m[3, 2 * begin + direction] == pytest.approx(3.0)


def test_a_street_that_is_met_within_a_stand_is_entered_from_all_of_its_scans_before():
    crossing = straight_poses(41)
    crossing[:, :2] = np.column_stack([np.full(41, 20.0), np.arange(-20.0, 21.0)])
    mapped = map_with_a_stand(300, crossing)
    graph = TravelGraph.of_map(mapped)
    entered = graph.strides.ahead[:, [2 * 100]].nonzero()[0] // 2
    assert set(entered.tolist()) == {580, 619, 620}


def test_a_stand_is_in_one_segment_wherever_the_drive_was_cut_meanwhile():
    graph = TravelGraph.of_map(map_with_a_stand(70))
    assert [graph.segment_at(row) for row in (0, 19, 20, 100, 400, 579, 599)] == [0, 0, *[8] * 5]


def test_the_jitter_of_poses_in_a_stand_is_no_way():
    mapped = map_with_a_stand(600)
    poses = mapped.trajectory.poses.copy()
    poses[20:580, :2] += np.random.default_rng(5).uniform(-0.1, 0.1, (560, 2))
    graph = TravelGraph.of_map(replace(mapped, trajectory=trajectory(poses)))
    assert graph.along_m[[20, 300, 579, -1]] == pytest.approx([20.0, 20.0, 20.0, 40.0], abs=0.5)


@pytest.mark.parametrize("travelled_m", [None, 1.0])
def test_no_observation_waits_for_the_walks_of_its_map(travelled_m):
    tracker = Tracker(Localizer(map_with_a_stand(70)))
    track = Track(tracker)
    with patch("core.tracking.graph.Walks", side_effect=AssertionError):
        for row in [*range(15, 20), *range(580, 584), *range(540, 500, -10)]:
            track.observe(observed(tracker, row, travelled_m=travelled_m))


@pytest.mark.parametrize("travelled_m", [None, 1.0])
def test_a_track_is_where_the_vehicle_is_once_it_drove_past_a_stand(travelled_m):
    tracker = Tracker(Localizer(map_with_a_stand(70)))
    track = Track(tracker)
    steps = [
        track.observe(observed(tracker, row, travelled_m=travelled_m))
        for row in [*range(8, 20), 300, *range(580, 592)]
    ]
    assert all(step.localized for step in steps[3:])
    assert [step.row for step in steps[-12:]] == list(range(580, 592))


@pytest.mark.parametrize("odometry", [False, True])
def test_the_segment_of_a_vehicle_in_a_stand_is_sure(odometry):
    tracker = Tracker(Localizer(map_with_a_stand(70)))
    track = Track(tracker)
    travelled_m = dict.fromkeys(range(8, 21), 1.0) | dict.fromkeys(range(100, 500, 7), 0.02)
    steps = [
        track.observe(observed(tracker, row, travelled_m=metres if odometry else None))
        for row, metres in travelled_m.items()
    ][4:]
    assert all(step.segment_sure for step in steps)
    assert [step.segment for step in steps] == [0] * 8 + [8] * 59
    of_stand = steps[8:]
    # The place from which the mapping vehicle drove on.
    assert [step.fraction for step in of_stand] == pytest.approx([19 / 39] * 59, abs=0.01)
    assert all(tracker.map.model.segment_of_scan[step.row] == 8 for step in of_stand)


def test_a_position_is_in_the_segment_between_two_cuts():
    graph = TravelGraph.of_map(sample_map(count=30, segment_length=10)[0])
    assert graph.segment_at(9.4) == 0
    assert graph.segment_at(9.6) == 1
    assert graph.segment_at(-3.0) == 0
    assert graph.segment_at(99.0) == 2


def test_cuts_that_are_not_between_segments_are_rejected():
    mapped, _ = sample_map(count=30, segment_length=10)
    with pytest.raises(InvalidParameters, match="cut must be between"):
        TravelGraph.of_map(mapped, np.array([-0.5, 12.0, 19.5, 29.5]))


@pytest.mark.parametrize(
    ("spacing_m", "missing", "known"),
    [(0.1, 50, True), (0.1, 60, False), (1.0, 5, True), (1.0, 6, False)],
)
def test_as_many_scans_without_a_pose_are_between_others_as_the_drive_has_in_6_metres(
    spacing_m, missing, known
):
    whole = sample_map(count=200, segment_length=50, step_m=spacing_m)[0]
    graph = TravelGraph.of_map(without_poses(whole, *range(60, 60 + missing)))
    assert np.isnan(graph.along_m).any() != known
    if known:
        np.testing.assert_allclose(graph.along_m, spacing_m * np.arange(200.0))


def test_a_joint_in_a_long_stand_is_looked_at_in_few_steps():
    crossing = straight_poses(40)
    crossing[:, 1], crossing[:, 0] = crossing[:, 0] - 20.0, 20.0
    mapped = map_with_a_stand(300, crossing)
    graph = TravelGraph.of_map(mapped)
    drives, places = mapped.trajectory, np.arange(2 * 600)
    with patch("core.tracking.graph.np.linalg.norm", wraps=np.linalg.norm) as steps:
        found = _directions(drives, _positions_m(drives), places)
    assert steps.call_count < 10  # a stand of 560 scans is one of them
    np.testing.assert_allclose(found[::2][:599, 0], 1.0)
    np.testing.assert_allclose(found[1::2][1:, 0], -1.0)
    assert np.isfinite(graph.strides.ahead_m).all()
