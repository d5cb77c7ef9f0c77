import math

import numpy as np
import pytest
from tensormap_client.odometer import FARTHEST_M, Odometer


def test_what_the_service_missed_is_added_up():
    odometer = Odometer()
    for sequence, travelled_m in enumerate([1.0, 2.0, -0.5, 4.0]):
        odometer.add(sequence, travelled_m)
    assert [odometer.since(sequence) for sequence in range(4)] == [5.5, 3.5, 4.0, 0.0]


def test_steps_of_numpy_are_summed_as_exactly_as_others():
    odometer = Odometer()
    odometer.add(0, np.float32(100_000.0))  # type: ignore[arg-type]
    for sequence in range(1, 1001):
        odometer.add(sequence, np.float32(0.125))  # type: ignore[arg-type]
        odometer.add(-sequence, np.float32(0.001))  # type: ignore[arg-type]
    assert odometer.since(0) == pytest.approx(126.0)


@pytest.mark.parametrize("unknown_m", [None, math.nan, math.inf])
def test_a_distance_with_an_unknown_part_is_unknown(unknown_m):
    odometer = Odometer()
    odometer.add(1, 1.0)
    odometer.add(2, unknown_m)
    odometer.add(3, 2.0)
    assert odometer.since(None) is None
    assert odometer.since(1) is None
    assert odometer.since(2) == 2.0


def test_a_distance_that_the_service_would_refuse_is_unknown():
    odometer = Odometer()
    for sequence in range(4):
        odometer.add(sequence, -FARTHEST_M / 2)
    assert odometer.since(0) is None
    assert odometer.since(1) == -FARTHEST_M


def test_it_does_not_grow_without_end():
    odometer = Odometer()
    for sequence in range(20_000):
        odometer.add(sequence, 1.0)
    assert odometer.since(0) is None
    assert odometer.since(15_000) == 4999.0
