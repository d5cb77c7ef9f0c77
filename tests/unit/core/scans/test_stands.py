"""Stands of the mapping vehicle: many scans in a row of one place."""

import numpy as np
import pytest

from core.scans.stands import first_of_stands
from tests.support.samples import straight_poses, trajectory


def standing(scans, step_m=1.0, jitter_m=0.0):
    """Return the poses of a vehicle that drives 20 scans, stands, and drives on for 20."""
    poses = straight_poses(40 + scans)
    poses[:, 0] = step_m * np.concatenate(
        [np.arange(20.0), np.full(scans, 20.0), np.arange(21, 41)]
    )
    jitter_m = np.random.default_rng(3).uniform(-jitter_m, jitter_m, (scans, 2))
    poses[20 : 20 + scans, :2] += jitter_m
    return poses


def stood(poses, *more):
    """Return the stands of drives, as sets of first and last rows."""
    stands = trajectory(poses, *more).stands
    rows = np.arange(len(stands))
    assert (stands[:, 0] <= rows).all()
    assert (rows <= stands[:, 1]).all()
    return sorted({(first, last) for first, last in stands.tolist() if first < last})


@pytest.mark.parametrize("jitter_m", [0.0, 0.02, 0.1])
@pytest.mark.parametrize("scans", [6, 600])
def test_a_stand_is_all_scans_of_one_place_however_their_poses_jitter(scans, jitter_m):
    assert stood(standing(scans, jitter_m=jitter_m)) == [(20, 19 + scans)]


def test_a_short_stop_and_a_slow_walk_are_no_stands():
    assert stood(standing(5)) == []
    assert stood(standing(0, step_m=0.09)) == []


def test_a_vehicle_that_creeps_stands_at_one_place_after_the_other():
    places = stood(straight_poses(80, step_m=0.049))
    assert [last - first + 1 for first, last in places] == [9] * 8 + [8]


def test_a_stand_ends_with_its_drive_and_at_a_scan_without_a_pose():
    poses = standing(100)
    assert stood(poses[:120], poses[20:]) == [(20, 119), (120, 219)]
    poses[60] = np.nan
    assert stood(poses) == [(20, 59), (61, 119)]


def test_maps_of_few_scans_have_none():
    assert stood(straight_poses(1)) == []
    assert stood(standing(5)[:5]) == []


def test_where_a_stand_counts_as_one_scan_its_first_one_counts():
    counted = first_of_stands(standing(30))
    assert np.flatnonzero(~counted).tolist() == list(range(21, 50))
    assert first_of_stands(np.full((9, 7), np.nan)).all()
