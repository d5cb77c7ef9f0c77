"""Splits of a drive into mapped and held-out scans (paper, sec. 3)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.errors import InvalidParameters
from core.evaluation.split import Every, Interleaved, parse_split


@given(st.lists(st.integers(1, 60), min_size=1, max_size=6))
def test_80_to_20_holds_out_every_fifth_scan_of_each_segment(sizes):
    starts = np.cumsum([0, *sizes])
    j = np.concatenate([np.arange(size) for size in sizes])
    np.testing.assert_array_equal(Interleaved(0.2).held_out(starts), j % 5 == 2)


@given(st.floats(0.01, 0.99), st.integers(1, 500))
def test_a_fraction_of_every_segment_is_held_out_to_a_scan(fraction, scans):
    held_out = Interleaved(fraction).held_out(np.array([0, scans]))
    assert abs(held_out.sum() - fraction * scans) <= 1.0


@pytest.mark.parametrize("percent", range(1, 100))
def test_every_fraction_of_two_digits_holds_out_scans_evenly(percent):
    held_out = Interleaved(percent / 100).held_out(np.array([0, 5000]))
    np.testing.assert_array_equal(held_out[100:], held_out[:-100])
    assert held_out[:100].sum() == percent
    gaps = np.diff(np.flatnonzero(held_out))
    assert set(gaps.tolist()) <= {100 // percent, -(-100 // percent)}


def test_the_phases_of_80_to_20_hold_out_every_scan_once():
    starts = np.array([0, 13, 40])
    held_out = np.stack([Interleaved(0.2, phase).held_out(starts) for phase in range(5)])
    assert held_out.sum(axis=0).tolist() == [1] * 40
    first = [np.flatnonzero(Interleaved(0.2, p).held_out(starts))[0] for p in range(5)]
    assert first == [2, 1, 0, 4, 3]


@pytest.mark.parametrize("n", [2, 3, 7])
def test_every_nth_scan_of_the_drive_is_mapped_and_the_others_are_queries(n):
    held_out = Every(n).held_out(np.array([0, 10, 23]))
    np.testing.assert_array_equal(held_out, np.arange(23) % n != 0)


@pytest.mark.parametrize(
    ("text", "split"),
    [
        ("interleaved:0.2", Interleaved(0.2)),
        ("interleaved:.25", Interleaved(0.25)),
        ("interleaved:0.2:3", Interleaved(0.2, 3)),
        ("every:2", Every(2)),
        ("every:10", Every(10)),
    ],
)
def test_a_split_is_read_and_written_in_one_form(text, split):
    assert parse_split(text) == split
    assert parse_split(str(split)) == split


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the split is ''"),
        ("interleaved", "wanted interleaved:FRACTION"),
        ("interleaved:1.5", "the split is"),
        ("interleaved:-0.2", "the split is"),
        ("interleaved:nan", "the split is"),
        ("interleaved:0.2:-1", "the split is"),
        ("interleaved:0.2:", "the split is"),
        ("interleaved:0.2\n", "the split is"),
        ("interleaved:0.0", "held-out fraction is 0.0"),
        ("every:1", "n is 1"),
        ("every:0", "n is 0"),
        ("every:2.5", "the split is"),
        ("every:" + "9" * 30, "the split is"),
        ("interleaved:0.2:" + "9" * 30, "the split is"),
        ("random:0.2", "the split is"),
    ],
)
def test_an_invalid_split_is_rejected(text, message):
    with pytest.raises(InvalidParameters, match=message):
        parse_split(text)


@pytest.mark.parametrize("fraction", [0.0, 1.0, -0.1, np.nan])
def test_a_fraction_without_queries_or_map_is_rejected(fraction):
    with pytest.raises(InvalidParameters, match="wanted 0 < f < 1"):
        Interleaved(fraction)
    with pytest.raises(InvalidParameters, match="phase is -1, wanted 0 to 4"):
        Interleaved(0.2, -1)
