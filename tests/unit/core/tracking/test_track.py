"""Tracks: the order of observations, uncertain places, and maps without poses."""

import numpy as np
import pytest

from core.encodings.signature import Signature
from core.errors import InvalidParameters, InvalidSignature, StaleObservation, StaleSignature
from core.localization.localizer import Localizer
from core.tracking.step import Doubt
from core.tracking.track import Observation, Track, Tracker
from tests.support.samples import (
    observed,
    own_signatures,
    sample_harmonic_map,
    sample_map,
    without_poses,
)


@pytest.fixture(scope="module", params=[sample_map, sample_harmonic_map])
def tracker(request):
    return Tracker(Localizer(request.param(count=40, segment_length=10)[0]))


def test_the_first_observations_are_not_yet_a_fix(tracker):
    track = Track(tracker)
    steps = [track.observe(observed(tracker, row)) for row in range(8)]
    assert not any(step.localized for step in steps[:2])
    assert all(step.localized and step.segment_sure for step in steps[5:])
    assert steps[1].reason == Doubt.CONVERGING
    assert [step.observations for step in steps] == list(range(1, 9))
    assert track.last == steps[-1]


def test_beside_a_cut_that_is_between_scans_no_segment_is_sure(tracker):
    start = tracker.map.model.segment_start
    beside = np.where(np.arange(len(start)) == 1, start, start - 0.5)  # at a scan, not half-way
    for cuts, sure in ((start - 0.5, True), (beside, False)):
        track = Track(Tracker(tracker.localizer, cut_position=cuts))
        steps = [track.observe(observed(tracker, row)) for row in (*range(start[1]), start[1])]
        assert steps[-1].row == start[1]
        assert steps[-1].localized
        assert steps[-1].segment_sure == sure


@pytest.mark.parametrize("name", ["timestamp_s", "sequence"])
def test_an_observation_that_is_not_newer_is_rejected_and_changes_nothing(tracker, name):
    track = Track(tracker)
    track.observe(observed(tracker, 3, **{name: 5}))
    belief = track.belief
    for stale in (5, 4):
        with pytest.raises(StaleObservation, match=f"{name} is {stale}"):
            track.observe(observed(tracker, 4, **{name: stale}))
    own = own_signatures(tracker.map, 3)[0]
    of_another = Observation((Signature(own.values, own.segment, "f" * 64),))
    with pytest.raises(StaleSignature):
        track.observe(of_another)
    with pytest.raises(InvalidSignature):
        track.observe(Observation(()))
    assert track.belief is belief
    assert track.observe(observed(tracker, 4, **{name: 6})).observations == 2


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ({"timestamp_s": np.nan}, "seconds"),
        ({"timestamp_s": 1.679e12}, "seconds"),  # milliseconds since 1970
        ({"travelled_m": np.inf}, "metres"),
        ({"travelled_m": -1e9}, "metres"),
        ({"sequence": -1}, "at least 0"),
    ],
)
def test_an_observation_rejects_impossible_values(tracker, given, wanted):
    with pytest.raises(InvalidParameters, match=f"wanted {wanted}"):
        observed(tracker, 0, **given)


def test_without_poses_a_scan_is_returned_and_no_metres():
    tracker = Tracker(Localizer(sample_harmonic_map(count=30, segment_length=10, poses=False)[0]))
    track = Track(tracker)
    steps = [track.observe(observed(tracker, row, travelled_m=1.0)) for row in range(6)]
    assert steps[-1].localized
    assert (steps[-1].row, steps[-1].pose, steps[-1].along_sigma_m) == (5, None, None)


def test_a_vehicle_that_is_moved_elsewhere_is_localized_again(tracker):
    track = Track(tracker)
    for row in range(8):
        track.observe(observed(tracker, row))
    steps = [track.observe(observed(tracker, row)) for row in range(25, 35)]
    found = [
        step.localized and step.row == row for row, step in zip(range(25, 35), steps, strict=True)
    ]
    assert all(found[6:])


def test_a_signature_from_elsewhere_is_an_unknown_place():
    mapped, _ = sample_harmonic_map(count=40, segment_length=10)
    tracker = Tracker(Localizer(mapped))
    track = Track(tracker)
    rng = np.random.default_rng(5)
    for _ in range(8):
        values = rng.normal(size=(3, 4)) + 1j * rng.normal(size=(3, 4))
        values[:, 0] = values[:, 0].real
        step = track.observe(
            Observation((Signature(values.astype(np.complex64), None, mapped.revision),))
        )
    assert not step.localized
    assert step.reason == Doubt.UNKNOWN_PLACE


def test_odometry_distinguishes_a_stop_from_motion(tracker):
    track = Track(tracker)
    for row in range(10):
        track.observe(observed(tracker, row, travelled_m=1.0))
    belief = track.belief.predicted(tracker.graph, tracker.motion, 1.0, 0.0)
    assert int(belief.of_scan.argmax()) == 9
    belief = track.belief.predicted(tracker.graph, tracker.motion, 1.0, 4.0)
    assert int(belief.of_scan.argmax()) == 13


def test_a_place_is_not_known_better_than_the_path_between_scans():
    # A scan is the path half-way to its neighbours, here a metre: the vehicle is anywhere on it.
    tracker = Tracker(Localizer(sample_harmonic_map(count=40, segment_length=10)[0]))
    track = Track(tracker)
    steps = [track.observe(observed(tracker, row, travelled_m=1.0)) for row in range(30)]
    assert steps[-1].localized
    assert 1.0 / np.sqrt(12.0) <= (steps[-1].along_sigma_m or 0.0) < 0.5
    assert 1.0 / np.sqrt(12.0) <= steps[-1].along_sigma_scans < 0.5


# Not 200 m: the spread of such a way, 20 m, reaches the next scans.
@pytest.mark.parametrize(("step_m", "half_m"), [(9.9, 4.95), (14.0, 7.0), (40.0, 10.0)])
def test_between_scans_far_from_each_other_a_place_is_as_long_as_half_way_up_to_ten_metres(
    step_m, half_m
):
    tracker = Tracker(Localizer(sample_map(count=40, segment_length=10, step_m=step_m)[0]))
    track = Track(tracker)
    steps = [track.observe(observed(tracker, row, travelled_m=step_m)) for row in range(30)]
    sigma_m = 2.0 * half_m / np.sqrt(12.0)
    assert sigma_m <= (steps[-1].along_sigma_m or 0.0) < 1.05 * sigma_m


def test_the_ends_of_drives_and_unknown_poses_make_no_place_longer():
    of_map = without_poses(sample_map(count=20, segment_length=10, drives=2)[0], *range(4, 14))
    variance_m2 = Tracker(Localizer(of_map)).row_variance_m2
    lengths_m = np.sqrt(12.0 * variance_m2[[0, 1, 3, 14, 19, 20, 21, 39]])
    np.testing.assert_allclose(lengths_m, [0.5, 1.0, 0.5, 0.5, 0.5, 0.5, 1.0, 0.5])
