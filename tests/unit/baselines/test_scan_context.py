"""Scan Context against its equations, term by term."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from baselines.scan_context import ScanContext, ScanContextPlaces, ring_keys
from core.errors import InvalidParameters, InvalidScan
from core.scans.scan import Scan


def naive_distance(query, place, shift):
    """Equation 5 over the columns that both hold."""
    cosines = []
    for j in range(query.shape[1]):
        a, b = query[:, j].astype(float), place[:, (j + shift) % query.shape[1]].astype(float)
        if a.any() and b.any():
            cosines.append(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)))
    return 1.0 - np.mean(cosines) if cosines else 1.0


def contexts(seed, count, rings=4, sectors=9, empty=0.6):
    rng = np.random.default_rng(seed)
    made = rng.uniform(0.1, 9.0, (count, rings, sectors)).astype(np.float32)
    made[rng.random(made.shape) < empty] = 0.0
    made[:, 0, 0] = 1.0
    return made


@given(seed=st.integers(0, 10_000), empty=st.sampled_from([0.1, 0.6, 0.95]))
@settings(max_examples=25, deadline=None)
def test_all_shifts_at_once_are_the_equations_one_by_one(seed, empty):
    query, *places = contexts(seed, 6, empty=empty)
    found = ScanContextPlaces(np.stack(places), None).distances(query, slice(None))
    expected = [[naive_distance(query, place, shift) for shift in range(9)] for place in places]
    np.testing.assert_allclose(found, expected, atol=2e-6)


@given(seed=st.integers(0, 10_000), before=st.integers(1, 30), candidates=st.integers(1, 30))
@settings(max_examples=25, deadline=None)
def test_candidates_are_those_with_the_nearest_ring_keys(seed, before, candidates):
    query, *places = contexts(seed, 31)
    stack = np.stack(places)
    found = ScanContext(4, 9, candidates=candidates).places(stack).nearest(query, before)
    assert found is not None
    apart = np.linalg.norm(ring_keys(stack)[:before] - ring_keys(query), axis=1)
    allowed = np.sort(apart)[min(candidates, before) - 1]
    assert found.row < before
    assert apart[found.row] <= allowed + 1e-12
    if candidates >= before:
        brute = ScanContext(4, 9).places(stack).nearest(query, before)
        assert found == brute


def test_a_cell_keeps_the_greatest_height_above_the_ground():
    scan = Scan(np.array([[10.0, 0.1, -0.73], [10.0, 0.2, 1.0], [10.0, -0.1, 4.0], [79.9, 0, -1]]))
    context = ScanContext(sensor_height_m=1.73).describe(scan)
    assert context[2, 0] == pytest.approx(2.73)
    assert context[2, 59] == pytest.approx(5.73)
    assert context[19, 0] == pytest.approx(0.73)
    assert np.count_nonzero(context) == 3


def test_the_height_of_the_sensor_is_not_ignored():
    scan = Scan(np.array([[10.0, 0.1, 0.5], [0.0, 50.0, 3.0]]))
    low, high = (ScanContext(sensor_height_m=h).describe(scan) for h in (1.0, 2.5))
    np.testing.assert_allclose((high - low)[low > 0], 1.5)


def test_returns_beyond_reach_and_below_the_ground_are_no_place():
    for points in ([[80.0, 0.0, 5.0]], [[10.0, 0.0, -2.0]]):
        with pytest.raises(InvalidScan, match="above the ground within 80 m"):
            ScanContext().describe(Scan(np.array(points)))


def test_ring_keys_are_the_share_of_sectors_that_hold_something():
    context = np.zeros((3, 4), np.float32)
    context[1, :2] = 5.0
    context[2] = 0.1
    assert ring_keys(context).tolist() == [0.0, 0.5, 1.0]


@pytest.mark.parametrize(
    "wrong",
    [
        {"rings": 0},
        {"sectors": 0},
        {"reach_m": 0.0},
        {"sensor_height_m": np.nan},
        {"candidates": 0},
    ],
)
def test_invalid_values_are_rejected(wrong):
    with pytest.raises(InvalidParameters):
        ScanContext(**wrong)
