"""Samples of the scans of a drive."""

import numpy as np
import pytest

from core.scans.sampling import spread_evenly


@pytest.mark.parametrize("count", [1, 200, 201, 5000])
def test_samples_are_spread_evenly_and_bounded(count):
    sample = spread_evenly(np.arange(10, 10 + count), 200)
    assert len(sample) == min(count, 200)
    assert (np.diff(sample) >= 1).all()
    assert sample[0] == 10
    assert sample[-1] == 9 + count
    if len(sample) > 1:
        assert np.ptp(np.diff(sample)) <= 1
