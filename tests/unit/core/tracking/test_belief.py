"""Beliefs of which each pace is kept at likely places only."""

from itertools import count
from unittest.mock import patch

import numpy as np
import pytest
from scipy.sparse import csr_array

from core.errors import InvalidParameters
from core.tracking.belief import Belief
from core.tracking.graph import TravelGraph
from core.tracking.motion import Motion
from core.tracking.stationary import PaceLikelihood
from core.tracking.strides import Strides
from core.tracking.walks import MAX_STRIDES
from tests.support.beliefs import belief_of_all
from tests.support.samples import sample_map

HERE, THERE = 100, 300
MOTION = Motion()


@pytest.fixture(scope="module")
def graph():
    return TravelGraph.of_map(sample_map(count=400, segment_length=100)[0])


@pytest.mark.parametrize("parts", [1, 16])
def test_on_a_round_course_of_even_steps_what_is_hardly_likely_may_be_missing_of_the_sum(parts):
    rows, step_m = np.arange(200), 0.1499  # the most scans are hardly likely then
    begin = np.concatenate([2 * rows, 2 * rows + 1])
    end = np.concatenate([2 * ((rows + 1) % 200), 2 * ((rows - 1) % 200) + 1])
    ahead = csr_array((np.ones(400), (end, begin)), shape=(400, 400))
    steps_m = np.full(400, step_m)
    course = TravelGraph(
        np.empty(0, np.int64), np.array([-0.5, 199.5]),
        np.array([[0, 199]]), Strides(ahead, steps_m, ahead, steps_m, np.ones(400, np.int64)),
        step_m * np.arange(200.0),
    )  # fmt: skip
    belief = Belief.at_any_pace(np.full(400, 1.0 / 400), 0.0, MOTION)
    for _ in range(parts):
        belief = belief.predicted(course, MOTION, 1.0, travelled_m=0.1338)
    assert belief.at.sum() + belief.others.sum() + belief.elsewhere == pytest.approx(1.0, abs=1e-7)


def observations_until_moved(graph, likelier, travelled_m):
    """Return how many a vehicle that stands still takes to leave a place for a likelier one."""
    at = np.full((graph.places, len(MOTION.pace)), 1e-12)
    at[2 * HERE, 0] = 1.0
    belief = belief_of_all(at / at.sum(), 0.0)
    of_scan = np.full(len(graph), np.exp(-8.0))
    of_scan[[HERE, THERE]] = 1.0, likelier
    still = np.where(MOTION.pace == 0.0, 0.9, 0.1)
    paces = PaceLikelihood(still, 0.9, np.zeros(graph.places, bool))
    for observations in count(1):
        belief = belief.predicted(graph, MOTION, 1.0, travelled_m).updated(of_scan, paces)
        if belief.of_scan[THERE] > 0.5 or observations == 200:
            return observations
    raise AssertionError


@pytest.mark.parametrize("travelled_m", [None, 0.0])
@pytest.mark.parametrize("likelier", [1.5, 2.0, 4.0])
def test_a_vehicle_that_stands_still_leaves_a_wrong_place_about_as_soon_as_with_all_paces_kept(
    graph, likelier, travelled_m
):
    observations = observations_until_moved(graph, likelier, travelled_m)
    with patch("core.tracking.belief._TIMES_FEWER", len(graph)):  # there are never as few
        of_all = observations_until_moved(graph, likelier, travelled_m)
    assert observations == pytest.approx(of_all, abs=2)
    assert of_all < 100


@pytest.fixture(scope="module")
def large():
    return TravelGraph.of_map(sample_map(count=6000, segment_length=1000)[0])


def test_a_new_belief_is_half_in_the_map_at_any_pace_and_keeps_none_apart(large):
    belief = Belief.unknown(large, MOTION)
    assert belief.elsewhere == 0.5
    assert not len(belief.places)
    by_pace = belief.by_pace(np.arange(large.places))
    np.testing.assert_allclose(by_pace, 0.5 / by_pace.size)


def test_of_a_large_map_the_likeliest_scans_advance_as_all_do_and_the_others_wait(large):
    of_scan = np.ones(len(large))  # nothing is certain
    of_scan[:1000], of_scan[500:520] = 10.0, 1000.0
    any_pace = PaceLikelihood(np.ones(len(MOTION.pace)), 1.0, np.zeros(large.places, bool))
    before = Belief.unknown(large, MOTION).updated(of_scan, any_pace)
    moved = before.predicted(large, MOTION)
    with patch("core.tracking.belief._MOST_LIKELY", len(large)):
        of_all = before.predicted(large, MOTION)
    assert len(of_all.places) == large.places
    assert len(moved.places) <= 2 * (1000 + MAX_STRIDES)
    likely = slice(500, 540)
    np.testing.assert_allclose(moved.of_scan[likely], of_all.of_scan[likely], rtol=0.02)
    waits = np.setdiff1d(np.arange(len(large)), moved.places // 2)
    np.testing.assert_allclose(moved.of_scan[waits], before.of_scan[waits], rtol=0.01)


@pytest.mark.parametrize(
    ("places", "others"), [([1, 0], [0.0, 0.0]), ([0, 0], [0.0, 0.0]), ([0, 1], [0.25, 0.0])]
)
def test_likely_places_rise_and_are_none_of_the_others(places, others):
    at = np.full((2, 1), (1.0 - sum(others)) / 2)
    with pytest.raises(InvalidParameters, match="rise"):
        Belief(np.array(places), at, np.array([others, [0.0, 0.0]]), 0.0)


def test_a_belief_that_does_not_sum_to_one_is_rejected():
    with pytest.raises(InvalidParameters, match=r"sum to 2\.1"):
        belief_of_all(np.full((4, 2), 0.2), 0.5)
    with pytest.raises(InvalidParameters):
        belief_of_all(np.array([[2.0, -1.0]]), 0.0)
