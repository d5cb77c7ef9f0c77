"""Tracks whose vehicle was not heard of for a time."""

import pytest

from core.localization.localizer import Localizer
from core.tracking.track import Track, Tracker
from tests.support.samples import observed, sample_harmonic_map, sample_map


@pytest.fixture(scope="module", params=[sample_map, sample_harmonic_map])
def tracker(request):
    return Tracker(Localizer(request.param(count=40, segment_length=10)[0]))


@pytest.mark.parametrize("travelled_m", [None, 1.0])
@pytest.mark.parametrize("name", ["timestamp_s", "sequence"])
def test_after_a_gap_a_place_is_accepted_when_three_observations_agree_again(
    tracker, name, travelled_m
):
    track, numbers = Track(tracker), [*range(10), *range(10, 16)]
    for number in range(10):
        step = track.observe(observed(tracker, number, **{name: number}, travelled_m=travelled_m))
    assert step.localized
    gap = 25  # of them did not come
    for number in numbers[10:]:
        metres = travelled_m and travelled_m + gap * (number == 10)
        given = {name: number + gap, "travelled_m": metres}
        row = min(number + gap, len(tracker.map) - 1)
        step = track.observe(observed(tracker, row, **given))
        if number < 12:
            assert not step.localized
    assert step.localized
    assert step.row == row


@pytest.mark.parametrize("name", ["timestamp_s", "sequence"])
def test_a_few_observations_that_did_not_come_are_no_gap(tracker, name):
    track = Track(tracker)
    for number in [*range(10), *range(14, 18)]:
        step = track.observe(observed(tracker, number, **{name: number}))
    assert step.localized
    at = track.observe(observed(tracker, 23, **{name: 23}))
    assert at.localized
    assert at.row == 23


@pytest.mark.parametrize("name", ["timestamp_s", "sequence"])
def test_observations_without_a_time_or_a_number_are_no_gap_before_the_next_that_has_it(
    tracker, name
):
    track = Track(tracker)
    for number in range(30):
        given = {} if 10 <= number < 22 else {name: number}
        step = track.observe(observed(tracker, number, **given))
        assert step.localized or number < 9
    assert step.row == 29


@pytest.mark.parametrize("name", ["timestamp_s", "sequence"])
@pytest.mark.parametrize("has_it", [lambda number: number % 2, lambda number: number < 8])
def test_a_gap_is_noticed_after_observations_without_a_time_or_a_number(tracker, name, has_it):
    track = Track(tracker)
    for number in range(14):
        given = {name: number} if has_it(number) else {}
        step = track.observe(observed(tracker, number, **given))
    assert step.localized
    assert not track.observe(observed(tracker, 26, **{name: 26})).localized
