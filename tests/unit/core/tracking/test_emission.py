"""Distances between a map's own scans."""

import numpy as np
import pytest

from core.tracking.emission import DistanceSpread
from tests.support.samples import own_signatures, sample_harmonic_map


def test_without_poses_all_scans_of_other_drives_are_elsewhere():
    tensor_map, _ = sample_harmonic_map(count=16, drives=2, poses=False)
    drive = tensor_map.trajectory.drive_of_scan
    nearest = [
        tensor_map.model.search(own_signatures(tensor_map, row)).distances()[drive != drive[row]]
        for row in range(len(tensor_map))
    ]
    expected = np.quantile([distances.min() for distances in nearest], 0.1)
    assert DistanceSpread.of_map(tensor_map).even == pytest.approx(expected)
