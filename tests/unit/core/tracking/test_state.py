"""The stored state of a track, and the track that continues it."""

import json
import tracemalloc
from dataclasses import asdict, replace
from unittest.mock import patch

import numpy as np
import pytest

from core.encodings.harmonic.model import HarmonicModel
from core.encodings.harmonic.numbers import SignatureNumbers
from core.errors import InvalidParameters, InvalidSignature, StaleObservation
from core.localization.localizer import Localizer
from core.tracking.belief import Belief
from core.tracking.graph import TravelGraph
from core.tracking.motion import Motion
from core.tracking.state import TrackState
from core.tracking.track import Observation, Track, Tracker
from tests.support.beliefs import belief_of_all
from tests.support.samples import observed, sample_harmonic_map, sample_map


@pytest.fixture(scope="module", params=[sample_map, sample_harmonic_map])
def tracker(request):
    return Tracker(Localizer(request.param(count=120, segment_length=30)[0]))


def driven(tracker, rows, **given):
    """Return a track that passed these rows."""
    track = Track(tracker)
    for row in rows:
        track.observe(observed(tracker, row, **given))
    return track


@pytest.mark.parametrize("gap_s", [0.0, 1.0, 600.0])
@pytest.mark.parametrize("first", [10, 12, 25, 90])
def test_a_continued_track_has_its_place_after_a_few_observations_and_no_wrong_one(
    tracker, gap_s, first
):
    track = Track(tracker, driven(tracker, range(10)).state, gap_s)
    rows = range(first, first + 10)
    steps = [track.observe(observed(tracker, row)) for row in rows]
    assert [step.observations for step in steps] == list(range(11, 21))
    assert not any(step.localized for step in steps[:2])
    assert {step.reason for step in steps[:2]} == {"converging"}
    assert all(step.localized for step in steps[6:])
    right = [abs(step.row - row) <= 1 for step, row in zip(steps, rows, strict=True)]
    assert all(right[i] for i in range(10) if steps[i].localized)


def test_of_two_places_that_look_alike_the_one_that_can_be_reached_is_taken():
    mapped, _ = sample_harmonic_map(count=60, segment_length=30, poses=False)
    stored = np.array(mapped.model.signatures)
    stored[42:] = stored[12:30]
    assert isinstance(mapped.model, HarmonicModel)
    model = replace(mapped.model, stored=SignatureNumbers(stored))
    tracker = Tracker(Localizer(replace(mapped, model=model)))
    seen = [observed(tracker, row) for row in range(12, 24)]
    new, continued = Track(tracker), Track(tracker, driven(tracker, range(12)).state, 0.1)
    assert not any(new.observe(observation).localized for observation in seen)
    steps = [continued.observe(observation) for observation in seen]
    assert [step.row for step in steps if step.localized][-1] == 23


def test_what_was_observed_before_is_rejected_by_the_track_that_continues(tracker):
    before = driven(tracker, [3], timestamp_s=5.0, sequence=7)
    track = Track(tracker, before.state, 1.0)
    for stale in ({"timestamp_s": 5.0}, {"sequence": 7}):
        with pytest.raises(StaleObservation):
            track.observe(observed(tracker, 4, **stale))
    step = track.observe(observed(tracker, 4, timestamp_s=5.1, sequence=8))
    assert step.observations == 2


def before_the_first_observation(track, observation):
    """Return the probability of each scan with which an observation is compared."""
    compared = []
    updated = Belief.updated

    def recorded(belief, *given):
        compared.append(belief.of_scan)
        return updated(belief, *given)

    with patch.object(Belief, "updated", recorded):
        track.observe(observation)
    return compared[0]


@pytest.mark.parametrize("given", [{}, {"timestamp_s": 40.0}])
def test_by_odometry_a_continued_track_is_as_far_on_whatever_the_gap_is(tracker, given):
    state = driven(tracker, range(20)).state
    state = replace(state, timestamp_s=9.0, periods_s=(1.0,))
    observation = observed(tracker, 50, travelled_m=31.0, **given)
    of_scan, at_once = (
        before_the_first_observation(Track(tracker, state, gap_s), observation)
        for gap_s in (25.0, 0.0)
    )
    np.testing.assert_array_equal(of_scan, at_once)
    assert of_scan[42:59].sum() > 0.45  # half of the belief is that of a new track


@pytest.mark.parametrize("gap_s", [0.25, 1.0, 600.0])
@pytest.mark.parametrize("timed", [False, True])
def test_without_odometry_a_continued_track_has_the_gap_once(tracker, gap_s, timed):
    state = replace(driven(tracker, range(20)).state, timestamp_s=9.0, periods_s=(0.125,))
    given = {"timestamp_s": 9.0 + gap_s} if timed else {}
    track = Track(tracker, state, 5.0 if timed else gap_s)  # the scans' own times are nearer
    of_scan = before_the_first_observation(track, observed(tracker, 25, **given))
    wanted = state.belief(tracker.graph, tracker.motion, gap_s).of_scan
    np.testing.assert_allclose(of_scan, wanted, atol=1e-9)


def test_the_gap_of_a_continued_track_is_no_usual_interval(tracker):
    track = Track(tracker)
    for row in range(9):
        track.observe(observed(tracker, row, timestamp_s=float(row), sequence=row))
    continued = Track(tracker, track.state, 40.0)
    continued.observe(observed(tracker, 9, timestamp_s=50.0, sequence=50))
    assert continued.state.periods_s == track.state.periods_s
    continued.observe(observed(tracker, 10, sequence=51))
    assert continued._order.share(observed(tracker, 11, sequence=53)) == 2.0


def test_where_metres_are_unknown_the_odometry_of_a_continued_track_is_not_used():
    tracker = Tracker(Localizer(sample_map(120, 30, poses=False)[0]))
    state = driven(tracker, range(20)).state
    of_scan = before_the_first_observation(
        Track(tracker, state, 1.0), observed(tracker, 25, travelled_m=6.0)
    )
    wanted = state.belief(tracker.graph, tracker.motion, 1.0).of_scan
    np.testing.assert_allclose(of_scan, wanted, atol=1e-9)


def test_a_continued_track_that_is_only_read_keeps_its_state(tracker):
    state = driven(tracker, range(20), timestamp_s=None).state
    track = Track(tracker, state, 2.0)
    assert track.state == state
    with pytest.raises(InvalidSignature):
        track.observe(Observation(()))
    assert track.state == state
    track.observe(observed(tracker, 21))
    assert track.state.observations == 21
    assert track.state.places != state.places


@pytest.fixture(scope="module")
def long_graph():
    """Of a map of two drives with more scans than a vehicle passes in half a minute."""
    return TravelGraph.of_map(sample_map(count=600, segment_length=200, drives=2)[0])


@pytest.mark.parametrize("gap_s", [0.0, 0.1, 5.0])
def test_in_a_gap_the_vehicle_advances_by_any_number_of_strides(long_graph, gap_s):
    state = TrackState(4, ((100, 0.5), (101, 0.1), (1190, 0.1), (1400, 0.1)), elsewhere=0.2)
    moved = np.zeros(long_graph.places)
    for place, probability in state.places:
        moved[place] = probability
    at = [moved]
    for _ in range(int(20 * gap_s)):
        moved = long_graph.strides.ahead @ moved
        at.append(moved)
    motion = Motion()
    new = Belief.unknown(long_graph, motion)
    belief = state.belief(long_graph, motion, gap_s)
    assert belief.of_place == pytest.approx(
        0.5 * np.mean(at, axis=0) + 0.5 * new.of_place, rel=1e-9
    )


def test_after_a_long_gap_every_place_is_as_likely(long_graph):
    state = TrackState(4, ((100, 0.5),), elsewhere=0.2)
    products = []

    class Counted:
        def __matmul__(self, other):
            products.append(1)
            return long_graph.strides.ahead @ other

    counting = replace(long_graph.strides, ahead=Counted())
    belief = state.belief(replace(long_graph, strides=counting), Motion(), 1e9)
    assert belief.of_scan == pytest.approx(np.full(len(long_graph), (1 - 0.35) / len(long_graph)))
    assert products == []


def test_a_track_without_observations_continues_as_a_new_one(tracker):
    track = Track(tracker, Track(tracker).state, 30.0)
    assert track.observations == 0
    assert (track.belief.at == Track(tracker).belief.at).all()


def test_a_state_is_small_and_plain(tracker):
    state = driven(tracker, range(20)).state
    written = json.dumps(asdict(state))
    assert len(written) < 4000
    read = json.loads(written)
    read |= {"places": tuple(map(tuple, read["places"])), "periods_s": tuple(read["periods_s"])}
    assert TrackState(**read) == state


@pytest.mark.parametrize(
    "wrong",
    [
        {"observations": -1},
        {"elsewhere": np.nan},
        {"places": ((-1, 0.5),)},
        {"places": ((0, np.inf),)},
        {"periods_s": (-1.0,)},
        {"timestamp_s": np.inf},
    ],
)
def test_a_state_rejects_impossible_values(wrong):
    with pytest.raises(InvalidParameters):
        TrackState(**{"observations": 1, "places": (), "elsewhere": 0.5, **wrong})


def test_a_state_of_a_larger_map_is_rejected(tracker):
    state = TrackState(observations=1, places=((10_000, 1.0),), elsewhere=0.0)
    with pytest.raises(InvalidParameters, match="the map has 240 places, the state 10000"):
        Track(tracker, state)


@pytest.mark.parametrize(("likely", "is_few"), [(0.24, False), (0.08, True)])
def test_a_belief_in_few_places_takes_hardly_more_memory_to_advance_than_one_in_all(
    long_graph, likely, is_few
):
    motion = Motion()
    peaks = []
    for share in (1.0, likely):
        at = np.full((long_graph.places, len(motion.pace)), 1e-12)
        at[: 2 * int(share * len(long_graph))] = 1.0
        belief = belief_of_all(at / at.sum(), 0.0)
        belief.predicted(long_graph, motion, travelled_m=3.0)  # its walks are computed once
        tracemalloc.start()
        predicted = belief.predicted(long_graph, motion, travelled_m=3.0)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert (len(predicted.places) < long_graph.places) == is_few
    assert peaks[1] < 1.2 * peaks[0]


@pytest.mark.parametrize("gap_s", [0.3, 2.0])
def test_after_a_gap_in_a_map_of_near_scans_each_of_them_is_as_likely_as_the_next(gap_s):
    graph = TravelGraph.of_map(sample_map(count=600, segment_length=200, step_m=0.1)[0])
    state = TrackState(4, ((2 * 100, 0.9),), elsewhere=0.0)
    of_scan = state.belief(graph, Motion(), gap_s).of_scan
    passed = of_scan[103 : 100 + int(gap_s * 100)]  # 20 strides a second
    assert passed.max() < 1.01 * passed.min()
    assert passed.min() > 3.0 * of_scan[50]


@pytest.mark.parametrize("step_m", [0.1, 1.0])
def test_after_a_gap_a_vehicle_is_hardly_more_often_at_the_end_of_its_drive_among_near_scans(
    step_m,
):
    graph = TravelGraph.of_map(sample_map(count=300, segment_length=100, step_m=step_m)[0])
    state = TrackState(4, ((2 * 150, 0.9),), elsewhere=0.0)
    assert state.belief(graph, Motion(), 20.0).of_scan[299] == pytest.approx(0.25, abs=0.03)
