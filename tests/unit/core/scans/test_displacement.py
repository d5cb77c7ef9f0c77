"""What a sensor beside a recorded place sees, and where it is."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from core.scans.displacement import left_of_m, places_beside_m, pose_beside, seen_from_beside
from core.scans.pose import heading_deg
from tests.support.samples import sample_points


@given(st.floats(-20, 20), st.floats(-180, 180), st.floats(-180, 180))
def test_returns_seen_from_beside_lie_where_they_did(left_m, turn_deg, yaw_deg):
    half = np.radians(yaw_deg) / 2
    recorded = np.array([3.0, -2.0, 1.0, 0.0, 0.0, np.sin(half), np.cos(half)])
    there = pose_beside(recorded, left_m, turn_deg)
    points = sample_points(0)
    np.testing.assert_allclose(
        in_world(there, seen_from_beside(points, left_m, turn_deg)),
        in_world(recorded, points.astype(np.float64)),
        atol=1e-9,
    )
    assert left_of_m(recorded, there) == pytest.approx(left_m, abs=1e-9)
    rotation = heading_deg(there[None])[0] - yaw_deg - turn_deg
    assert (rotation + 180) % 360 - 180 == pytest.approx(0, abs=1e-6)


@given(
    st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda numbers: np.linalg.norm(numbers) > 0.1),
    *[st.floats(-20, 20)] * 2,
    st.floats(-180, 180),
)
def test_a_pose_beside_is_what_rotations_make_of_it(numbers, left_m, ahead_m, turn_deg):
    at_m, recorded = np.array([3.0, -2.0, 1.0]), Rotation.from_quat(numbers)
    row = np.concatenate([at_m, recorded.as_quat()])
    there = pose_beside(row, left_m, turn_deg, ahead_m)
    rotation = recorded * Rotation.from_euler("z", turn_deg, degrees=True)
    np.testing.assert_allclose(there[:3], at_m + recorded.apply([ahead_m, left_m, 0]), atol=1e-12)
    assert (rotation.inv() * Rotation.from_quat(there[3:])).magnitude() < 1e-7
    assert there[6] >= 0.0
    beside_m = places_beside_m(row[None], np.array([left_m]))[0, 0]
    np.testing.assert_allclose(beside_m, pose_beside(row, left_m)[:3], atol=1e-12)
    assert left_of_m(row, there) == pytest.approx(left_m, abs=1e-9)


def in_world(row, points):
    heading = np.radians(heading_deg(row[None])[0])
    turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    return np.column_stack([points[:, :2] @ turn.T + row[:2], points[:, 2] + row[2]])


def test_an_unknown_pose_stays_unknown():
    unknown = np.full(7, np.nan)
    assert np.isnan(pose_beside(unknown, 1.0, 2.0)).all()
    assert np.isnan(left_of_m(unknown, unknown))
