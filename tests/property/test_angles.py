"""Rounded angles against the functions of double precision that they replace."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from core.projection.angles import azimuth_columns, azimuth_steps, elevation_steps

STEPS_DEG = [90.0, 45.0, 2.0, 1.0, 0.2, 0.1, 360 / 1024, 0.001, 1e-8]
numbers = st.floats(width=32, allow_nan=False, allow_infinity=False) | st.sampled_from(
    [0.0, -0.0, 1.0, -1.0, 1e-45, 3.4e38]
)
steps_deg = st.sampled_from(STEPS_DEG)


def pairs(count):
    shape = st.tuples(st.just(2), st.integers(1, count))
    return hnp.arrays(np.float32, shape, elements=numbers).map(np.float64)


@given(pairs(40), steps_deg)
@example(np.array([[0.0, -0.0, 0.0, -0.0, -1.0, -1.0], [0.0, 0.0, -0.0, -0.0, 0.0, -0.0]]), 1.0)
@example(np.array([[3.4e38, -3.4e38, 1e-45, -1e-45], [3.4e38, 3.4e38, 1e-45, -2e-45]]), 1.0)
def test_azimuths_are_rounded_as_arctan2_is(coordinates, step_deg):
    x, y = coordinates
    expected = np.rint(np.degrees(np.arctan2(y, x)) / step_deg)
    assert azimuth_steps(x, y, step_deg).tolist() == expected.tolist()


@given(pairs(40), st.sampled_from([2, 4, 60, 360, 1024]))
@example(np.array([[-1.0, -1.0, -1.0], [0.0, -0.0, -1e-3]]), 360)
def test_columns_go_round_from_straight_ahead(coordinates, columns):
    azimuth_deg = np.degrees(np.arctan2(coordinates[1], coordinates[0]))
    expected = np.rint(azimuth_deg / (360.0 / columns)).astype(int) % columns
    points_m = np.stack([*coordinates, np.ones(coordinates.shape[1])], axis=1).astype(np.float32)
    assert azimuth_columns(points_m, columns).tolist() == expected.tolist()


@given(pairs(40), steps_deg, st.sampled_from([0.0, 0.5, -0.5, 0.3]))
@example(np.array([[0.0, 0.0, 3.4e38], [1e-45, -3.4e38, 3.4e38]]), 1.0, 0.0)
def test_elevations_are_rounded_as_arctan_is(coordinates, step_deg, first_step):
    across, up = np.abs(coordinates[0]), coordinates[1]
    somewhere = (across > 0.0) | (up != 0.0)
    across, up = across[somewhere], up[somewhere]
    with np.errstate(divide="ignore"):
        expected = np.rint(np.degrees(np.arctan(up / across)) / step_deg - first_step)
    assert elevation_steps(across, up, step_deg, first_step).tolist() == expected.tolist()


@pytest.mark.parametrize("step_deg", STEPS_DEG)
def test_angles_around_the_middle_between_two_steps_are_rounded_exactly(step_deg):
    rng = np.random.default_rng(0)
    middles = (np.floor(rng.uniform(-180, 180, 50_000) / step_deg) + 0.5) * step_deg
    angle = np.radians(middles + rng.choice([1e-3, 1e-4, 3e-5, 1e-5, 1e-6, 1e-8, 0.0], 50_000))
    range_m = 10.0 ** rng.uniform(-3, 3, 50_000)
    x = (range_m * np.cos(angle)).astype(np.float32).astype(np.float64)
    y = (range_m * np.sin(angle)).astype(np.float32).astype(np.float64)
    azimuth_deg, elevation_deg = np.degrees(np.arctan2(y, x)), np.degrees(np.arctan(y / np.abs(x)))
    assert (azimuth_steps(x, y, step_deg) == np.rint(azimuth_deg / step_deg)).all()
    assert (elevation_steps(np.abs(x), y, step_deg) == np.rint(elevation_deg / step_deg)).all()
