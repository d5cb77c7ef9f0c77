"""Laws of the filter: probabilities sum to 1, and a map's own drive is tracked."""

from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.localization.localizer import Localizer
from core.tracking.belief import Belief
from core.tracking.graph import TravelGraph
from core.tracking.motion import Motion
from core.tracking.step import Direction
from core.tracking.track import Observation, Track, Tracker
from tests.support.beliefs import belief_of_all
from tests.support.samples import own_signatures, sample_harmonic_map, sample_map, without_poses

pytestmark = pytest.mark.slow

MAKERS = {"paper": sample_map, "harmonic": sample_harmonic_map}
TRACKERS = {
    (name, drives): Tracker(Localizer(make(count=40, segment_length=10, drives=drives)[0]))
    for name, make in MAKERS.items()
    for drives in (1, 2)
}
# A short gap in one drive, which is filled, and half of the other one without poses.
TRACKERS["partly posed", 2] = Tracker(
    Localizer(without_poses(sample_map(40, 10, drives=2)[0], 2, 20, *range(50, 70)))
)
trackers = st.sampled_from(list(TRACKERS.values()))
few = settings(max_examples=20, deadline=None)  # each tracks a drive
seeds = st.integers(0, 2**32 - 1)
shares = st.floats(0.05, 20.0)
metres = st.none() | st.floats(-200.0, 200.0)


def belief_of(seed, tracker):
    """Return any belief, some of it exactly 0."""
    rng = np.random.default_rng(seed)
    at = rng.uniform(size=(tracker.graph.places, len(tracker.motion.pace)))
    at = at * rng.integers(0, 2, at.shape)
    elsewhere = rng.uniform()
    total = at.sum() + elsewhere
    return belief_of_all(at / total, elsewhere / total)


def in_few_places(belief, row):
    """Return a belief of which each pace is kept at one scan only."""
    places = 2 * row + np.arange(2)
    others = np.stack([belief.at[:, 0], belief.at[:, 1:].sum(axis=1)])
    others[:, places] = 0.0
    return Belief(places, belief.at[places], others, belief.elsewhere)


def feed(tracker, rows, **options):
    track = Track(tracker)
    return [track.observe(Observation(own_signatures(tracker.map, row), **options)) for row in rows]


def require_probabilities(belief):
    at = belief.by_pace(np.arange(belief.others.shape[1]))
    assert np.isfinite(at).all()
    assert at.min() >= 0.0 <= belief.elsewhere
    assert at.sum() + belief.elsewhere == pytest.approx(1.0, abs=1e-9)
    assert at.sum(axis=1) == pytest.approx(belief.of_place, abs=1e-15)
    assert (belief.others[:, belief.places] == 0.0).all()


@few
@given(trackers, seeds, st.none() | st.integers(0, 39), shares, metres)
def test_a_predicted_belief_sums_to_one(tracker, seed, row, share, travelled_m):
    belief = belief_of(seed, tracker)
    if row is not None:
        belief = in_few_places(belief, row)
    require_probabilities(belief.predicted(tracker.graph, tracker.motion, share, travelled_m))


@few
@given(trackers, st.integers(0, 39), seeds, shares, metres)
def test_a_belief_in_few_places_advances_as_one_in_all_of_them(
    tracker, row, seed, share, travelled_m
):
    graph, motion = tracker.graph, tracker.motion
    rng = np.random.default_rng(seed)
    at = rng.uniform(size=(graph.places, len(motion.pace))) * 1e-12
    at[2 * row : 2 * row + 2] = rng.uniform(size=(2, len(motion.pace)))
    belief = belief_of_all(at / at.sum(), 0.0)
    predicted = belief.predicted(graph, motion, share, travelled_m)
    with patch("core.tracking.belief._TIMES_FEWER", len(graph)):  # there are never as few
        in_all = belief.predicted(graph, motion, share, travelled_m)
    everywhere = np.arange(graph.places)
    np.testing.assert_allclose(
        predicted.by_pace(everywhere), in_all.by_pace(everywhere), rtol=0.0, atol=1e-8
    )


@few
@given(trackers, st.integers(0, 39), seeds, st.booleans())
def test_an_update_of_few_places_is_that_of_all_where_others_move_at_all_paces_alike(
    tracker, row, seed, stationary
):
    rng = np.random.default_rng(seed)
    few_kept = in_few_places(belief_of(seed, tracker), row)
    everywhere = np.arange(tracker.graph.places)
    all_kept = belief_of_all(few_kept.by_pace(everywhere), few_kept.elsewhere)
    of_scan = rng.uniform(0.0, 10.0, len(tracker.map))
    paces = tracker.stationary.likelihood(tracker.motion.pace, stationary=stationary)
    one, other = few_kept.updated(of_scan, paces), all_kept.updated(of_scan, paces)
    assert one.of_place == pytest.approx(other.of_place, abs=1e-12)
    assert one.at == pytest.approx(other.at[one.places], abs=1e-12)
    assert one.elsewhere == pytest.approx(other.elsewhere, abs=1e-12)


@few
@given(trackers, seeds)
def test_an_updated_belief_sums_to_one_whatever_the_distances_are(tracker, seed):
    rng = np.random.default_rng(seed)
    distances = np.exp(rng.uniform(-600, 600, len(tracker.map)))
    distances[rng.integers(0, 2, len(distances)) == 0] = rng.choice([0.0, np.inf])
    likelihood = tracker.emission.likelihood(distances)
    assert np.isfinite(likelihood).all()
    paces = tracker.stationary.likelihood(tracker.motion.pace, stationary=bool(seed % 2))
    require_probabilities(belief_of(seed, tracker).updated(likelihood, paces))


@given(trackers)
def test_the_probabilities_of_the_next_place_sum_to_one(tracker):
    assert tracker.graph.strides.ahead.sum(axis=0) == pytest.approx(1.0)


@few
@given(trackers, st.integers(0, 10), st.integers(1, 4))
def test_the_maps_own_scans_are_tracked_exactly(tracker, start, stride):
    rows = list(range(start, 40, stride))
    steps = feed(tracker, rows)
    for row, step in list(zip(rows, steps, strict=True))[3:]:
        assert (step.row, step.segment) == (row, row // 10)
    assert all(step.localized for step in steps[6:])
    assert step.direction == Direction.ALONG


@few
@given(trackers, st.integers(30, 39), st.integers(1, 3))
def test_backwards_they_are_tracked_against_their_direction(tracker, start, stride):
    rows = list(range(start, -1, -stride))
    for row, step in list(zip(rows, feed(tracker, rows), strict=True))[3:]:
        assert step.row == row
    assert step.direction == Direction.AGAINST


@few
@given(trackers, st.integers(0, 39))
def test_a_stationary_vehicle_gets_one_place(tracker, row):
    steps = feed(tracker, [row] * 8)
    assert all(step.stationary for step in steps[2:])
    assert {(step.row, step.segment) for step in steps[3:]} == {(row, row // 10)}
    assert len({step.position for step in steps[3:]}) == 1


@few
@given(trackers, st.lists(st.integers(0, 39), min_size=1, max_size=8))
def test_equal_drives_get_equal_answers_and_tracks_are_independent(tracker, rows):
    one, other, stranger = Track(tracker), Track(tracker), Track(tracker)
    for row in rows:
        observation = Observation(own_signatures(tracker.map, row))
        first = one.observe(observation)
        stranger.observe(Observation(own_signatures(tracker.map, 39 - row)))
        assert other.observe(observation) == first


@few
@given(trackers, seeds, st.sampled_from([0.0, 3.0, -3.0, 10.0]))
def test_odometry_moves_a_known_place_by_that_many_metres(tracker, seed, travelled_m):
    row = 15 + seed % 8
    at = np.zeros((tracker.graph.places, len(tracker.motion.pace)))
    at[2 * row] = 1.0 / at.shape[1]
    moved = belief_of_all(at, 0.0).predicted(tracker.graph, tracker.motion, 1.0, travelled_m)
    assert moved.of_scan.argmax() == row + travelled_m


@given(st.integers(1, 6), st.integers(1, 3))
def test_segments_that_meet_lead_to_each_other_in_both_directions(length, drives):
    graph = TravelGraph.of_map(
        sample_map(count=2 * length, segment_length=length, drives=drives)[0]
    )
    for drive in range(drives):
        last, first = 2 * length * drive + length - 1, 2 * length * drive + length
        assert graph.strides.ahead[[2 * first], [2 * last]] == 1.0
        assert graph.strides.ahead[[2 * last + 1], [2 * first + 1]] == 1.0
        end = 2 * length * (drive + 1) - 1
        assert graph.strides.ahead[[2 * end], [2 * end]] == 1.0


@given(shares)
def test_the_numbers_of_passed_scans_at_each_pace_are_a_distribution(share):
    passed = Motion().passed(share)
    assert passed.min() >= 0.0
    assert passed.sum(axis=1) == pytest.approx(1.0)
    assert passed[0, 0] == 1.0
    assert Motion().pace_change.sum(axis=1) == pytest.approx(1.0)
