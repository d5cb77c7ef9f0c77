"""Scans named by times take indices between those that are stored."""

import numpy as np
import pytest

from app.drives.time_order import TimeOrder
from app.http.errors import MalformedUpload
from storage.store.put_scans import MOST_SCANS
from tests.support.recording import tar


def order(times, scans=(), stored_s=()):
    body = tar((f"{time_s}.npy", b"returns") for time_s in times)
    names = lambda: iter([body])  # noqa: E731
    stored = np.array(scans, dtype=np.int64), np.array(stored_s, dtype=np.float64)
    found = TimeOrder(names, *stored)
    return [found.index(time_s) for time_s in times]


def test_of_a_new_drive_the_index_is_the_rank() -> None:
    assert order([3.5, 1.5, 2.5]) == [2, 0, 1]


def test_stored_scans_keep_theirs_and_others_take_what_is_free_between() -> None:
    assert order([0.5, 1.5, 2.5, 3.5, 4.5], [1, 4], [1.5, 4.5]) == [0, 1, 2, 3, 4]
    assert order([5.5, 6.5], [1, 4], [1.5, 4.5]) == [5, 6]


def test_fractions_that_may_be_nanoseconds_without_leading_zeros_are_an_error() -> None:
    with pytest.raises(MalformedUpload, match=r"^9\.5\.npy and 9\.123456789\.npy .*nothing was"):
        order([9.5, 9.123456789])
    assert order([9.5, 9.123456789, 9.012345678]) == [2, 1, 0]


@pytest.mark.parametrize(
    ("times", "message"),
    [([0.25, 0.5], "0.5.npy is before scan 1"), ([2.5, 2.75, 3.5], "3.5.npy is before scan 4")],
)
def test_without_a_free_index_they_are_an_error(times, message) -> None:
    with pytest.raises(MalformedUpload, match=message):
        order(times, [1, 4], [1.5, 4.5])


def test_behind_the_last_index_of_a_drive_none_is_left_and_stored_scans_are_found() -> None:
    last = MOST_SCANS - 1
    assert order([4.5, 5.5], [last - 1], [4.5]) == [last - 1, last]
    with pytest.raises(MalformedUpload, match=r"^6\.5\.npy .* 1000000000 .*nothing was stored$"):
        order([4.5, 5.5, 6.5], [last - 1], [4.5])
    assert order([4.5], [2**53 - 1], [4.5]) == [2**53 - 1]  # of an earlier version


@pytest.mark.parametrize(
    ("stored_s", "flaw"),
    [
        ([1.5, np.nan, 3.5], "scan 4 of the drive has no time, wanted"),
        ([np.nan, 2.5, np.nan], "scan 1 of the drive has no time, and 1 more have none"),
        ([2.5, 1.5, 3.5], "scan 4 of the drive, at 1.5 s, is not after scan 1 at 2.5 s"),
        ([2.5, 2.5, 3.5], "scan 4 of the drive, at 2.5 s, is not after scan 1 at 2.5 s"),
    ],
)
def test_stored_scans_must_have_times_that_rise_and_the_first_that_does_not_is_named(
    stored_s, flaw
) -> None:
    with pytest.raises(MalformedUpload, match=f"^{flaw}.*set times with PUT .*nothing was stored"):
        order([9.5], [1, 4, 7], stored_s)
