"""Strides lead to the next scan, and over several where scans are nearer each other."""

import numpy as np
import pytest
from scipy.sparse import csr_array

from core.tracking.strides import Strides


def street(steps_m):
    """Return the strides of a street of places with so many metres from each to the next."""
    steps_m = np.array([*steps_m, 0.0])
    rows = np.arange(len(steps_m))
    end = np.minimum(rows + 1, rows[-1])
    ahead = csr_array((np.ones(len(rows)), (end, rows)), shape=(len(rows), len(rows)))
    return ahead, Strides.of_scans(ahead, steps_m, np.zeros(len(rows), np.int64))


def from_place(steps, place):
    """Return where a place leads, and how probable each is."""
    column = steps[:, [place]].toarray()[:, 0]
    return {int(end): pytest.approx(column[end]) for end in np.flatnonzero(column)}


@pytest.mark.parametrize("step_m", [0.38, 0.5, 1.0, 9.0])
def test_where_scans_are_far_apart_a_stride_is_one_scan(step_m):
    ahead, strides = street([step_m] * 5)
    assert strides.ahead is ahead
    assert strides.last is ahead
    assert strides.last_m.tolist() == [step_m] * 5 + [0.0]


def test_among_scans_near_each_other_a_stride_is_half_a_metre_and_the_last_ends_around_it():
    _, strides = street([0.1] * 40)
    assert from_place(strides.ahead, 3) == {8: 1.0}
    assert from_place(strides.last, 3) == dict.fromkeys([6, 7, 8, 9, 10], 0.2)
    assert (strides.ahead_m[3], strides.last_m[3]) == pytest.approx((0.5, 0.5))


def test_a_stride_ends_where_the_street_ends():
    _, strides = street([0.1] * 10)
    assert from_place(strides.ahead, 7) == {10: 1.0}
    assert from_place(strides.last, 7) == {10: 1.0}
    assert strides.last_m[7:].tolist() == pytest.approx([0.3, 0.2, 0.1, 0.0])


def test_where_none_is_half_a_metre_away_a_stride_leads_to_the_scan_nearest_to_it():
    _, strides = street([0.1, 2.0, 0.1, 0.3, 2.0])
    assert from_place(strides.ahead, 0) == {1: 1.0}
    assert from_place(strides.ahead, 2) == {4: 1.0}


def test_where_metres_are_unknown_a_stride_passes_as_many_scans_as_usual_in_that_drive():
    _, strides = street([*[0.1] * 30, *[np.nan] * 20, *[0.1] * 30])
    assert strides.scans[[5, 27, 40, 60]].tolist() == [5, 5, 5, 5]
    assert from_place(strides.ahead, 40) == {45: 1.0}
    assert from_place(strides.last, 40) == dict.fromkeys([43, 44, 45, 46, 47], 0.2)
    assert np.isnan(strides.ahead_m[[27, 40, 49]]).all()
    assert strides.ahead_m[[20, 50]].tolist() == pytest.approx([0.5, 0.5])


@pytest.mark.parametrize("known_m", [[], [1.0] * 10])
def test_without_metres_or_nearer_scans_it_passes_one(known_m):
    ahead, strides = street([*known_m, *[np.nan] * 20, *known_m])
    assert strides.ahead is ahead
    assert strides.last is ahead


def test_of_two_scans_at_one_place_both_are_reached():
    _, strides = street([1.0, 0.0] * 10)
    assert from_place(strides.last, 2) == {3: 0.5, 4: 0.5}
    assert from_place(strides.ahead, 3) == {5: 1.0}


def test_at_a_crossing_a_stride_leads_into_every_street():
    # Places 0 to 2 lead to 3 and to 6, each of which begins a street of three.
    ends = np.array([1, 2, 3, 6, 4, 5, 5, 7, 8, 8])
    begins = np.array([0, 1, 2, 2, 3, 4, 5, 6, 7, 8])
    ahead = csr_array((1.0 / np.bincount(begins)[begins], (ends, begins)), shape=(9, 9))
    step_m = np.where(np.isin(np.arange(9), [5, 8]), 0.0, 0.25)
    strides = Strides.of_scans(ahead, step_m, np.zeros(9, np.int64))
    assert from_place(strides.ahead, 1) == {3: 0.5, 6: 0.5}
    assert from_place(strides.ahead, 2) == {4: 0.5, 7: 0.5}
    assert strides.ahead_m[:3].tolist() == [0.5] * 3


def test_probabilities_of_random_streets_sum_to_one_and_lengths_are_those_of_the_places():
    rng = np.random.default_rng(0)
    for _ in range(50):
        steps_m = rng.choice([0.0, 0.08, 0.1, 0.2, 0.3, 0.6, 3.0], 60)
        _, strides = street(steps_m)
        along_m = np.concatenate([[0.0], np.cumsum(steps_m)])
        for steps, mean_m in ((strides.ahead, strides.ahead_m), (strides.last, strides.last_m)):
            assert steps.sum(axis=0) == pytest.approx(1.0)
            assert along_m @ steps.toarray() - along_m == pytest.approx(mean_m)
