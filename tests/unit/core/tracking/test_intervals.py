"""Intervals between observations of which some have no time."""

import math

import pytest

from core.tracking.intervals import Intervals


def kept(*times):
    intervals = Intervals()
    for time in times:
        intervals.keep(time, continues=False)
    return intervals


def test_the_interval_before_an_observation_is_a_share_of_the_usual():
    assert kept(0.0, 0.5, 1.0, 1.5).share(3.0) == 3.0


@pytest.mark.parametrize(
    ("now", "expected"),
    [(6.0, 1.0), (26.0, 21.0), (4.0, 1 / 3)],
    ids=["as usual", "an outage", "faster than usual"],
)
def test_those_without_a_time_came_after_the_usual_one_and_the_rest_is_the_last(now, expected):
    assert kept(0.0, 1.0, 2.0, 3.0, None, None).share(now) == pytest.approx(expected)


def test_nothing_is_known_before_the_second_time_and_of_an_observation_without_one():
    assert kept(0.0).share(1.0) is None
    assert kept(0.0).since(1.0) == 1.0
    assert kept(0.0, 1.0).share(None) is None
    assert kept().since(1.0) == math.inf


def test_the_interval_between_two_tracks_is_not_kept_as_usual():
    intervals = kept(0.0, 1.0)
    intervals.keep(100.0, continues=True)
    assert intervals.share(101.0) == 1.0
