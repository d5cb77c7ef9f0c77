"""Poses are adjusted to closures, as far as both are trusted."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.odometry import pose_graph
from core.odometry.closures import Closure
from core.odometry.pose_graph import adjust
from core.scans.rigid import inverse, planar

STEPS = 200
ROUND = [planar(2.0, 0.0, 360.0 / STEPS)] * STEPS  # 400 m, back to the start


def along(steps):
    poses = [np.eye(4)]
    for step in steps:
        poses.append(poses[-1] @ step)
    return np.array(poses)


@pytest.fixture(scope="module")
def drifted():
    """True poses of a circle, and those of odometry whose heading and height drift."""
    drift = np.eye(4)
    drift[:3, :3] = Rotation.from_euler("zy", [0.02, 0.01], degrees=True).as_matrix()
    drift[2, 3] = 0.005
    return along(ROUND), along([step @ drift for step in ROUND])


def off_m(poses, true):
    return np.linalg.norm(poses[:, :3, 3] - true[:, :3, 3], axis=1)


def closure(true, first, second):
    return Closure(first, second, inverse(true[first]) @ true[second])


def test_without_closures_poses_stay_and_their_deviations_grow(drifted):
    _, odometry = drifted
    found = adjust(odometry, np.ones(len(odometry), bool), ())
    assert found.poses == pytest.approx(odometry, abs=1e-6)
    assert (np.diff(found.sigmas[:, 0]) >= 0.0).all()
    assert 1.0 < found.sigmas[-1, 0] < 8.0  # of 400 m


def test_a_closure_is_spread_over_the_drive(drifted):
    true, odometry = drifted
    alone = adjust(odometry, np.ones(len(odometry), bool), ())
    found = adjust(odometry, np.ones(len(odometry), bool), [closure(true, 0, STEPS)])
    assert off_m(odometry, true)[-1] > 3.0
    assert off_m(found.poses, true)[-1] < 0.3
    assert off_m(found.poses, true).max() < 0.6 * off_m(odometry, true).max()
    assert found.poses[0] == pytest.approx(np.eye(4))
    steps = inverse(found.poses[:-1]) @ found.poses[1:]
    assert np.abs(steps - np.array(ROUND)).max() < 0.06  # nowhere is it torn
    assert found.sigmas[-1, 0] < 0.5
    assert found.sigmas[STEPS // 2, 0] < alone.sigmas[STEPS // 2, 0]
    assert found.kept.tolist() == [True]


def test_a_wrong_closure_among_right_ones_is_not_kept(drifted):
    true, odometry = drifted
    right = [closure(true, at, STEPS - at) for at in (0, 2, 4)]
    wrong = Closure(10, 110, planar(0.0, 0.0, 0.0))
    found = adjust(odometry, np.ones(len(odometry), bool), [*right, wrong])
    assert found.kept.tolist() == [True, True, True, False]
    assert off_m(found.poses, true)[-1] < 0.5


def test_a_step_that_was_not_registered_takes_what_a_closure_corrects():
    true = along(ROUND)
    steps = list(ROUND)
    steps[100] = steps[100] @ planar(6.0, 3.0, 10.0)
    registered = np.ones(STEPS + 1, bool)
    registered[101] = False
    found = adjust(along(steps), registered, [closure(true, 0, STEPS)])
    assert off_m(found.poses, true).max() < 0.3


def test_a_vehicle_that_stands_after_many_lost_scans_has_finite_deviations():
    odometry = along([planar(1.0, 0.0, 0.0)] * 995 + [np.eye(4)] * 4)
    registered = np.ones(1000, bool)
    registered[100:500] = False
    for closures in ((), [closure(odometry, 0, 998)]):
        found = adjust(odometry, registered, closures)
        assert np.isfinite(found.sigmas).all()
        assert np.isfinite(found.poses).all()
    assert found.sigmas[999, 0] == pytest.approx(found.sigmas[998, 0], abs=1e-3)


def test_one_scan_and_a_vehicle_that_stands_are_no_division_by_zero():
    assert len(adjust(np.zeros((0, 4, 4)), np.zeros(0, bool), ()).poses) == 0
    assert adjust(np.eye(4)[None], np.ones(1, bool), ()).sigmas.tolist() == [[0.0, 0.0]]
    found = adjust(np.tile(np.eye(4), (30, 1, 1)), np.ones(30, bool), ())
    assert np.isfinite(found.sigmas).all()
    assert found.sigmas.max() < 0.01


def test_a_search_that_does_not_converge_ends_with_the_best_poses_that_it_found(
    drifted, monkeypatch
):
    true, odometry = drifted
    closures = [closure(true, at, STEPS - at) for at in (0, 2, 4)]
    registered = np.ones(len(odometry), bool)
    evaluations = 0
    residuals = pose_graph._Graph._residuals

    def counted(graph, corrections):
        nonlocal evaluations
        evaluations += 1
        return residuals(graph, corrections)

    monkeypatch.setattr(pose_graph._Graph, "_residuals", counted)
    monkeypatch.setattr(pose_graph, "_MOST_EVALUATIONS", 3)
    found = adjust(odometry, registered, closures)
    assert evaluations == 3
    assert np.isfinite(found.poses).all()
    assert np.isfinite(found.sigmas).all()
    assert off_m(found.poses, true)[-1] < off_m(odometry, true)[-1]
    monkeypatch.undo()
    assert off_m(adjust(odometry, registered, closures).poses, true)[-1] < 0.3
