"""Nodes at turns."""

import numpy as np
import pytest

from core.mapping.pipeline import build
from core.parameters import MapParameters, Segmentation
from core.scans.drive import MemoryDrive
from core.scans.pose import Pose
from core.scans.scan import Scan
from core.scans.trajectory import Trajectory
from core.segmentation.fixed import cut_drives
from core.segmentation.turns import cut_at_turns
from tests.support.samples import sample_points, straight_poses

SCANS, CORNER = 80, 43


def around_a_corner(corner=CORNER, step_m=1.5):
    """Return poses along x up to a corner and along y after it."""
    poses = straight_poses(SCANS, step_m)
    poses[corner:, 0] = poses[corner, 0]
    poses[corner:, 1] = step_m * np.arange(SCANS - corner)
    return poses


def trajectory(poses):
    return Trajectory.of_drive("monday", np.arange(len(poses)) / 10.0, poses, np.arange(len(poses)))


def cuts_of(poses, length):
    mapped = trajectory(poses)
    return cut_at_turns(mapped, cut_drives(mapped.drive_start, length))


def test_a_segment_is_cut_in_the_middle_of_a_turn():
    assert np.abs(cuts_of(around_a_corner(), 80) - [0, CORNER, 80]).max() <= 2


@pytest.mark.parametrize(("length", "cuts"), [(40, [0, 40, 80]), (44, [0, 44, 80])])
def test_a_turn_within_ten_metres_of_a_cut_has_its_node_there(length, cuts):
    assert cuts_of(around_a_corner(), length).tolist() == cuts


def test_a_turn_farther_from_the_next_cut_has_a_node_of_its_own():
    cuts = cuts_of(around_a_corner(), 30)
    assert np.abs(cuts - [0, 30, CORNER, 60, 80]).max() <= 2


def test_nothing_is_cut_on_a_straight_road_or_without_poses():
    assert cuts_of(straight_poses(SCANS, 1.5), 40).tolist() == [0, 40, 80]
    assert cuts_of(np.full((SCANS, 7), np.nan), 40).tolist() == [0, 40, 80]


def test_each_drive_is_cut_at_its_own_turns():
    drives = [around_a_corner(), around_a_corner(30) + np.array([900.0, 0, 0, 0, 0, 0, 0])]
    mapped = Trajectory.concatenate(
        [
            Trajectory.of_drive(f"drive-{i}", np.arange(SCANS) / 10.0, poses, np.arange(SCANS))
            for i, poses in enumerate(drives)
        ]
    )
    cuts = cut_at_turns(mapped, cut_drives(mapped.drive_start, SCANS))
    assert np.abs(cuts - [0, CORNER, SCANS, SCANS + 30, 2 * SCANS]).max() <= 2


@pytest.mark.parametrize(("encoding", "nodes"), [("harmonic", 3), ("paper", 2)])
def test_a_default_map_has_a_node_at_a_turn_and_fixed_segments_of_the_paper_have_none(
    encoding, nodes
):
    poses = around_a_corner()
    drive = MemoryDrive(
        "monday",
        [
            Scan.from_returns(sample_points(i), timestamp_s=0.1 * i, pose=Pose.from_row(row))
            for i, row in enumerate(poses)
        ],
    )
    parameters = MapParameters.for_sensor(encoding=encoding, segmentation=Segmentation.FIXED)
    topology = build([drive], parameters, calibrated=False).tensor_map.topology
    assert len(topology.node_scan) == nodes
    if nodes == 3:
        assert abs(topology.node_scan[1] - CORNER) <= 2
