"""A path is as long as a vehicle drove, however long it stood."""

import math

import numpy as np
import pytest

from core.scans.path import arc_lengths_m, path_length_m, path_steps_m
from core.scans.trajectory import Trajectory
from core.topology.graph import Topology
from core.topology.lines import driven_lines
from tests.support.samples import straight_poses


def rows_at(x_m, noise_m=0.0):
    rows = straight_poses(len(x_m))
    rows[:, 0] = x_m
    rows[:, :3] += np.random.default_rng(0).normal(scale=noise_m, size=(len(x_m), 3))
    return rows


def with_a_stop(step_m, noise_m):
    """Return the poses of 100 m of road with 60 s at 10 Hz half-way."""
    way_m = np.arange(0.0, 50.0, step_m)
    return rows_at(np.concatenate([way_m, np.full(600, 50.0), 50.0 + way_m, [100.0]]), noise_m)


def of_drive(rows):
    return Trajectory.of_drive("d", np.full(len(rows), np.nan), rows, np.arange(len(rows)))


def test_a_path_is_as_long_as_its_steps_and_unknown_where_a_pose_is():
    rows = straight_poses(5, step_m=2.0)
    assert path_length_m(rows) == 8.0
    assert path_length_m(rows[:1]) == 0.0
    rows[3] = np.nan
    assert math.isnan(path_length_m(rows))
    assert math.isnan(path_length_m(rows[3:4]))


@pytest.mark.parametrize("noise_m", [0.005, 0.02, 0.1])
def test_a_stop_adds_nothing_to_lengths_however_its_poses_jitter(noise_m):
    rows = with_a_stop(2.0, noise_m)
    drive = of_drive(rows)
    whole_m = Topology.of_segments(drive, np.array([0, len(drive)])).edge_length_m[0]
    assert whole_m == pytest.approx(100.0, abs=2.0)
    assert drive.path_m(0, len(drive) - 1) == whole_m
    assert path_length_m(rows) == pytest.approx(whole_m)
    [line] = driven_lines(drive)
    assert whole_m == pytest.approx(line.length_m, abs=1.0)


def test_positions_along_a_stop_never_go_back_and_end_where_it_ends():
    rows = with_a_stop(1.0, 0.02)
    along_m = arc_lengths_m(rows[:, :3])
    assert (np.diff(along_m) >= 0.0).all()
    assert along_m[40] == pytest.approx(40.0, abs=0.5)
    assert along_m[-1] - along_m[60] == pytest.approx(50.0, abs=2.0)


@pytest.mark.parametrize("step_m", [0.05, 0.3, 1.0, 1.5, 12.0])
@pytest.mark.parametrize("turn_deg", [0.0, 1.0, 20.0])
def test_a_path_without_jitter_has_the_length_of_its_steps(step_m, turn_deg):
    heading = np.radians(turn_deg) * step_m * np.arange(80)
    steps = step_m * np.column_stack([np.cos(heading), np.sin(heading), 0.1 + 0.0 * heading])
    positions_m = np.concatenate([np.zeros((20, 3)), np.cumsum(steps, axis=0)])
    expected_m = np.linalg.norm(np.diff(positions_m, axis=0), axis=1)
    assert path_steps_m(positions_m).tolist() == expected_m.tolist()


def test_one_position_and_none_have_no_steps():
    assert path_steps_m(np.zeros((1, 3))).tolist() == []
    assert path_steps_m(np.zeros((0, 3))).tolist() == []


def test_a_path_through_other_drives_is_not_known():
    parts = [of_drive(straight_poses(3)), Trajectory.of_drive("e", *_row(9.0))]
    joined = Trajectory.concatenate(parts)
    assert joined.steps_m[:2].tolist() == [1.0, 1.0]
    assert math.isnan(joined.steps_m[2])


def _row(x_m):
    return np.zeros(1), rows_at(np.array([x_m])), np.array([0])
