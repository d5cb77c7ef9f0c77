"""The nearest place of queries, and the recall of those that have one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.evaluation.nearest import nearest_place, recall_within
from tests.support.samples import straight_poses


def poses_at(*xs):
    poses = straight_poses(len(xs))
    poses[:, 0] = xs
    return poses


UNKNOWN = np.nan


def test_the_nearest_place_with_a_pose_is_found():
    places = poses_at(0.0, UNKNOWN, 9.0)
    rows, metres = nearest_place(places, poses_at(1.0, 8.5, UNKNOWN))
    assert rows.tolist() == [0, 2, -1]
    np.testing.assert_allclose(metres, [1.0, 0.5, np.nan])


@pytest.mark.parametrize("places", [poses_at(), poses_at(UNKNOWN)])
def test_without_a_place_the_nearest_is_infinitely_far(places):
    for first_excluded in (None, np.array([0, 0])):
        rows, metres = nearest_place(places, poses_at(1.0, UNKNOWN), first_excluded)
        assert rows.tolist() == [-1, -1]
        np.testing.assert_array_equal(metres, [np.inf, np.nan])


@given(st.integers(0, 2**32 - 1))
def test_a_query_is_compared_with_the_places_before_the_first_excluded(seed):
    rng = np.random.default_rng(seed)
    places, queries = poses_at(*rng.normal(size=8)), poses_at(*rng.normal(size=6))
    places[rng.random(8) < 0.2, 0] = UNKNOWN
    first_excluded = rng.integers(0, 9, size=6)
    rows, metres = nearest_place(places, queries, first_excluded)
    for query, last in enumerate(first_excluded):
        row, metre = nearest_place(places[:last], queries[query : query + 1])
        assert rows[query] == row[0]
        assert metres[query] == pytest.approx(metre[0])


def test_recall_is_of_findable_queries_and_unknown_without_one():
    nearest_m = np.array([1.0, 4.0, 50.0, np.nan, 0.0])
    answered_m = np.array([1.0, 50.0, 60.0, np.nan, np.nan])
    assert recall_within(answered_m, nearest_m, 3.0) == (1, 1.0)
    assert recall_within(answered_m, nearest_m, 5.0) == (2, 0.5)
    assert recall_within(answered_m, nearest_m, 0.5) == (0, None)
