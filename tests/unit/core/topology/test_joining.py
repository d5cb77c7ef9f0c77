"""Cuts of drives that meet, in maps of many hours."""

import time

import numpy as np
import pytest

from core.scans.trajectory import Trajectory
from core.segmentation.fixed import cut_fixed
from core.topology.joining import cut_at_meetings
from core.topology.streets import find_streets

_BLOCK_M = 80


def _round_a_grid(scans: int, streets: int) -> Trajectory:
    """Return a drive at random through a grid of streets, a scan a metre."""
    rng = np.random.default_rng(0)
    steps = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
    at, heading, corners = np.zeros(2, int), 0, [np.zeros(2, int)]
    while len(corners) * _BLOCK_M <= scans:
        turned = int((heading + rng.integers(-1, 2)) % 4)  # never back
        there = at + steps[turned]
        if (there >= 0).all() and (there < streets).all():
            at, heading = there, turned
            corners.append(at)
    corner_m = np.arange(len(corners)) * _BLOCK_M
    poses = np.zeros((scans, 7))
    poses[:, 6] = 1.0
    for axis, along in enumerate(np.transpose(corners) * _BLOCK_M):
        poses[:, axis] = np.interp(np.arange(scans), corner_m, along)
    return Trajectory.of_drive("town", np.arange(scans) / 10.0, poses, np.arange(scans))


@pytest.mark.slow
def test_cutting_a_drive_of_many_hours_takes_no_longer_than_finding_its_streets():
    trajectory = _round_a_grid(100_000, 24)
    begun_s = time.process_time()
    streets = find_streets(trajectory)
    found_s = time.process_time()
    cuts = cut_at_meetings(trajectory, cut_fixed(len(trajectory), 100))
    cut_s = time.process_time()
    assert len(streets.stretches) > 100
    assert len(cuts) > 500
    assert cut_s - found_s < 2.0 * (found_s - begun_s)
