"""Arrays that nobody can write to."""

import numpy as np

from core.arrays import frozen

POINTS = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], dtype=np.float32)


def test_freezing_a_frozen_array_copies_nothing():
    once = frozen(POINTS, np.float32)
    assert frozen(once, np.float32) is once
