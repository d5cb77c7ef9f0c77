"""Metres along the drives of a map, some of whose scans have no pose, and its segments."""

from dataclasses import replace

import numpy as np
import pytest

from core.errors import InvalidParameters
from core.localization.localizer import Localizer
from core.topology import join_segments
from core.tracking.graph import TravelGraph
from core.tracking.track import Observation, Track, Tracker
from tests.support.samples import own_signatures, sample_harmonic_map, sample_map, without_poses


def two_drives(*unposed):
    """Return a map of two drives of 40 scans each, a metre apart, some of them without a pose."""
    return without_poses(sample_harmonic_map(40, 10, drives=2)[0], *unposed)


def test_a_scan_without_a_pose_is_evenly_between_its_neighbours():
    whole, gap = TravelGraph.of_map(two_drives()), TravelGraph.of_map(two_drives(2))
    np.testing.assert_allclose(gap.along_m, whole.along_m)
    np.testing.assert_allclose(gap.step_m, whole.step_m)


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
    along, against = graph.step_m[::2], graph.step_m[1::2]
    assert (along[39], against[40]) == (10.0, 10.0)
    np.testing.assert_allclose(np.delete(along[:-1], 39), 1.0)
    np.testing.assert_allclose(np.delete(against[1:], 39), 1.0)
    assert (along[-1], against[0]) == (0.0, 0.0)
    assert graph.along_m[[39, 40]].tolist() == [39.0, 39.0]


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
