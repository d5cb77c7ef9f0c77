"""Odometry: how far it leads, and in maps that know the metres of some places only."""

import numpy as np
import pytest

from core.errors import InvalidParameters
from core.tracking.graph import TravelGraph
from core.tracking.motion import Motion
from core.tracking.walks import MAX_STRIDES
from tests.support.samples import sample_map, without_poses

MOTION = Motion()
PACE_OF_ONE = int(np.flatnonzero(MOTION.pace == 1.0)[0])


@pytest.fixture(scope="module")
def graph():
    """Two drives of 60 scans, the first one without poses."""
    return TravelGraph.of_map(without_poses(sample_map(60, 60, drives=2)[0], *range(60)))


def advanced(graph, row, travelled_m, *, few):
    """Return the most likely row of a vehicle that drove from `row` along the segment."""
    places = 2 * row + np.arange(2) if few else np.arange(graph.places)
    at = np.zeros((len(places), len(MOTION.pace)))
    at[places == 2 * row, PACE_OF_ONE] = 1.0
    reached, moved = MOTION.advance(places, at, graph, travelled_m=travelled_m)
    assert moved.sum() == pytest.approx(1.0)
    return int(reached[moved.sum(axis=1).argmax()]) // 2


@pytest.mark.parametrize("way_m", [0.0, 0.1, 0.5, 1.5, 3.0, 8.0, 20.0])
@pytest.mark.parametrize("step_m", [1.0, 8.0])
def test_odometry_leads_as_far_as_the_way_also_by_parts_of_a_stride(step_m, way_m):
    apart = TravelGraph.of_map(sample_map(100, 100, step_m=step_m)[0])
    places = np.arange(apart.places)
    motion = Motion(turns_round=1e-9)
    at = np.zeros((apart.places, len(motion.pace)))
    at[20, PACE_OF_ONE] = 1.0
    times = 40 if way_m < 1.0 else 3
    for _ in range(times):
        _, at = motion.advance(places, at, apart, travelled_m=way_m)
    driven_m = step_m * (at.sum(axis=1) @ (places // 2) - 10.0)
    assert driven_m == pytest.approx(times * way_m, rel=0.01, abs=1e-3)


def test_the_mean_of_strides_of_any_lengths_is_the_way_driven():
    rng = np.random.default_rng(3)
    stride_m = rng.uniform(0.1, 4.0, (MAX_STRIDES, 50)) * (rng.random((MAX_STRIDES, 50)) < 0.7)
    length_m = np.concatenate([np.zeros((1, 50)), stride_m.cumsum(axis=0)])
    for way_m in (0.0, 0.3, 2.0, 9.0):
        probability = MOTION.passed_m(length_m, way_m)
        np.testing.assert_allclose(probability.sum(axis=0), 1.0)
        np.testing.assert_allclose(
            (probability * length_m).sum(axis=0), way_m, rtol=1e-6, atol=1e-6
        )


@pytest.mark.parametrize("few", [True, False])
def test_odometry_is_used_in_a_drive_with_poses_beside_one_without(graph, few):
    assert advanced(graph, 80, 6.0, few=few) == 86
    assert advanced(graph, 90, -6.0, few=few) == 84


@pytest.mark.parametrize("few", [True, False])
def test_where_metres_are_unknown_the_pace_is_used(graph, few):
    for travelled_m in (None, 6.0, -6.0, -0.001):
        assert advanced(graph, 20, travelled_m, few=few) == 21


def test_odometry_in_a_map_without_poses_changes_nothing():
    unposed = TravelGraph.of_map(sample_map(60, 60, poses=False)[0])
    at = np.full((unposed.places, len(MOTION.pace)), 1.0)
    at[7] = 5.0
    without, given = (
        MOTION.advance(np.arange(unposed.places), at, unposed, travelled_m=travelled_m)
        for travelled_m in (None, -3.0)
    )
    np.testing.assert_array_equal(without[1], given[1])


@pytest.mark.parametrize(
    "wrong",
    [
        {"pace": np.array([1.0, 2.0])},
        {"pace": np.array([0.0, 2.0, 1.0])},
        {"keeps": 0.99, "drifts": 0.02},
        {"jumps": 0.0},
        {"spread": 0.0},
    ],
)
def test_a_motion_rejects_impossible_values(wrong):
    with pytest.raises(InvalidParameters):
        Motion(**wrong)


def test_the_numbers_of_strides_in_the_usual_time_are_computed_once():
    motion = Motion()
    assert motion.passed() is motion.passed(1.0)
    np.testing.assert_allclose(motion.passed(1.0), motion.passed(1.0 + 1e-12))
