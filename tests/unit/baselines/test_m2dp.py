"""M2DP against its section III, plane by plane."""

import numpy as np
import pytest

from baselines.m2dp import M2dp
from baselines.voxels import voxel_means
from core.errors import InvalidParameters, InvalidScan
from core.evaluation.condition import Condition
from core.scans.scan import Scan


def cloud(seed=0, count=400):
    rng = np.random.default_rng(seed)
    # Longer in x than in y than in z, and skewed, so that the principal axes have a direction.
    return rng.gamma(2.0, 1.0, (count, 3)) * [12.0, 5.0, 1.5] + [3.0, -2.0, 0.5]


def naive(points, p, q, l, t):  # noqa: E741 - the paper's letters
    """Count return by return on each plane; the frame is NumPy's SVD."""
    centred = points - points.mean(axis=0)
    unsigned = np.linalg.svd(centred, full_matrices=False)[2][:2]
    axes = [a if ((centred @ a) ** 3).sum() >= 0 else -a for a in unsigned]
    aligned = centred @ np.stack([*axes, np.cross(*axes)]).T
    farthest = np.linalg.norm(aligned, axis=1).max()
    signature = np.zeros((p * q, l * t))
    for i in range(p):
        for k in range(q):
            a, e = np.pi * i / p, 0.5 * np.pi * k / q
            m = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
            x = np.eye(3)[0] - m[0] * m
            if np.linalg.norm(x) < 1e-9:
                x = np.eye(3)[1] - m[1] * m
            x /= np.linalg.norm(x)
            y = np.cross(m, x)
            for point in aligned:
                u, v = point @ x, point @ y
                circle = min(int(l * np.sqrt(np.hypot(u, v) / farthest)), l - 1)
                sector = int(np.floor(np.arctan2(v, u) / (2 * np.pi) * t)) % t
                signature[i * q + k, circle * t + sector] += 1
    left, _, right = np.linalg.svd(signature)
    return np.concatenate([np.abs(left[:, 0]), np.abs(right[0])])


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_whole_arrays_count_what_loops_count(seed):
    points = cloud(seed)
    described = M2dp(4, 5, 6, 7, voxel_m=0.0).describe(Scan(points))
    # A return in single precision may fall on the other side of an edge.
    expected = naive(points.astype(np.float32).astype(float), 4, 5, 6, 7)
    np.testing.assert_allclose(described, expected, atol=5e-3)


def test_both_parts_have_norm_one_and_no_negative_number():
    described = M2dp().describe(Scan(cloud()))
    assert np.linalg.norm(described[:64]) == pytest.approx(1.0, abs=1e-6)
    assert np.linalg.norm(described[64:]) == pytest.approx(1.0, abs=1e-6)
    assert described.min() >= -1e-6


def test_a_shifted_and_rotated_cloud_is_the_same_place():
    scan = Scan(cloud())
    moved = Condition(yaw_deg=137.0, lateral_m=4.0).apply(scan, np.random.default_rng(0))
    method = M2dp(voxel_m=0.0)
    np.testing.assert_allclose(method.describe(moved), method.describe(scan), atol=0.02)


def test_returns_at_one_place_are_none():
    with pytest.raises(InvalidScan, match="at one place"):
        M2dp().describe(Scan(np.full((5, 3), 2.0)))


@pytest.mark.parametrize("wrong", [{"azimuths": 0}, {"sectors": 0}, {"voxel_m": np.nan}])
def test_invalid_values_are_rejected(wrong):
    with pytest.raises(InvalidParameters):
        M2dp(**wrong)


def test_cubes_that_cannot_be_numbered_are_still_distinguished():
    far = np.array([[1e9, 0, 0], [1e9, 0, 0], [-1e9, 1e9, -1e9], [0.1, 0.1, 1e9]], np.float32)
    assert len(voxel_means(far, 0.001)) == 3
