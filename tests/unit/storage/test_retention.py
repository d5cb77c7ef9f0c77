"""Which revisions a policy does not keep: laws for every history, and some histories by hand."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.errors import InvalidParameters
from storage.retention import Candidate, OwnRetention, RawScans, Retention, to_collect

NOW = datetime(2026, 1, 31, tzinfo=UTC)


def day(number: float) -> datetime:
    return NOW - timedelta(days=number)


def candidate(digest, created=0.0, retained=None, **facts):
    number = round(1e6 * (100.0 - created))
    return Candidate(digest, number, day(created if retained is None else retained), **facts)


HISTORY = [
    candidate("a", 40),
    candidate("b", 30, 12),
    candidate("c", 20, 2),
    candidate("d", 10, live=True),
    candidate("e", 5),
]


def test_by_default_everything_stays():
    assert to_collect(HISTORY, Retention(), NOW) == ()
    assert Retention().raw_scans == RawScans.KEEP


@pytest.mark.parametrize(
    ("count", "days", "gone"),
    [
        (0, 0.0, ("a", "b", "c")),
        (0, 10.0, ("a", "b")),
        (0, 13.0, ("a",)),
        (1, 0.0, ("a", "b")),
        (2, 0.0, ("a",)),
        (3, 0.0, ()),
        ("all", 0.0, ()),
        (0, 40.0, ("a",)),
        (0, 41.0, ()),
    ],
)
def test_what_neither_its_number_nor_its_age_keeps_goes_oldest_first(count, days, gone):
    assert to_collect(HISTORY, Retention(count, days), NOW) == gone


def test_what_was_live_until_now_counts_from_its_replacement():
    rolled_back = [candidate("a", 90, 0), candidate("b", 80, live=True), candidate("c", 70)]
    assert to_collect(rolled_back, Retention(0, 1.0), NOW) == ()
    assert to_collect(rolled_back, Retention(0, 0.0), NOW) == ("a",)


def test_revisions_that_a_job_needs_stay():
    history = [replace(one, needed=one.digest == "b") for one in HISTORY]
    assert to_collect(history, Retention(0, 0.0), NOW) == ("a", "c")


def test_a_map_without_revisions_has_none_to_collect():
    assert to_collect([], Retention(0, 0.0), NOW) == ()


ages = st.floats(0, 100)
histories = st.lists(st.tuples(ages, ages, st.booleans()), max_size=12).flatmap(
    lambda facts: st.integers(-1, len(facts) - 1).map(
        lambda live: [
            candidate(f"{i:02}", created, min(created, retained), live=i == live, needed=needed)
            for i, (created, retained, needed) in enumerate(facts)
        ]
    )
)


@given(histories, st.integers(0, 12), st.floats(0, 100))
def test_what_goes_is_old_enough_and_enough_others_stay(history, count, days):
    gone = to_collect(history, Retention(count, days), NOW)
    stays = [one for one in history if one.digest not in gone]
    assert len(set(gone)) == len(gone)
    for one in history:
        if one.digest in gone:
            assert not one.live
            assert not one.needed
            assert one.retained_from <= NOW - timedelta(days=days)
            younger = [o for o in stays if not o.live and o.retained_from >= one.retained_from]
            assert len(younger) >= count
    if history:
        assert max(history, key=lambda one: (one.number, one.digest)) in stays
    # A second pass collects nothing.
    assert to_collect(stays, Retention(count, days), NOW) == ()


@given(histories, st.integers(0, 11), st.floats(0, 99), st.floats(0, 1))
def test_a_policy_that_keeps_more_collects_no_other(history, count, days, longer):
    gone = set(to_collect(history, Retention(count, days), NOW))
    assert set(to_collect(history, Retention(count + 1, days + longer), NOW)) <= gone


def test_a_map_chooses_some_and_takes_the_rest_from_the_service():
    default = Retention(5, 7.0, RawScans.DROP)
    own = OwnRetention(retained_revisions="all", raw_scans=RawScans.KEEP)
    assert own.over(default) == Retention("all", 7.0, RawScans.KEEP)
    assert OwnRetention(**own.chosen()) == own
    assert replace(own, raw_scans=None).over(default).raw_scans == RawScans.DROP


@pytest.mark.parametrize(
    "wrong",
    [
        {"retained_revisions": -1},
        {"retained_revisions": 10**7},
        {"retained_for_days": -0.1},
        {"retained_for_days": float("nan")},
        {"retained_for_days": float("inf")},
    ],
)
def test_values_out_of_range_are_rejected(wrong):
    with pytest.raises(InvalidParameters, match=next(iter(wrong))):
        Retention(**wrong)
    with pytest.raises(InvalidParameters):
        OwnRetention(**wrong)
