"""The laws of cutting a drive into segments (paper, sec. 2.2)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.errors import EmptyDrive, InvalidParameters
from core.segmentation.fixed import cut_drives, cut_fixed, segment_length_for

scan_counts = st.integers(1, 5000)
lengths = st.integers(1, 6000)


@given(scan_counts, lengths)
def test_segments_cover_all_scans_and_none_is_empty(scans, length):
    starts = cut_fixed(scans, length)
    assert (starts[0], starts[-1]) == (0, scans)
    assert (np.diff(starts) >= 1).all()


@given(scan_counts, lengths)
def test_all_but_the_last_segment_have_k_scans_and_the_last_half_to_one_and_a_half(scans, length):
    sizes = np.diff(cut_fixed(scans, length))
    assert (sizes[:-1] == length).all()
    assert sizes[-1] < 1.5 * length
    assert sizes[-1] == scans if len(sizes) == 1 else 2 * sizes[-1] >= length


@given(st.integers(1, 50), st.integers(1, 300))
def test_a_length_that_divides_the_drive_is_the_papers_cut(segments, length):
    assert np.diff(cut_fixed(segments * length, length)).tolist() == [length] * segments


@pytest.mark.parametrize(("scans", "sizes"), [(11, [4, 4, 3]), (10, [4, 4, 2]), (9, [4, 5])])
def test_a_last_segment_shorter_than_half_joins_the_one_before(scans, sizes):
    assert np.diff(cut_fixed(scans, 4)).tolist() == sizes


@given(st.lists(st.integers(1, 400), min_size=1, max_size=6), lengths)
def test_drives_never_share_a_segment(drive_lengths, length):
    drive_start = np.cumsum([0, *drive_lengths])
    cuts = cut_drives(drive_start, length)
    assert set(drive_start.tolist()) <= set(cuts.tolist())
    alone = [np.diff(cut_fixed(scans, length)) for scans in drive_lengths]
    np.testing.assert_array_equal(np.diff(cuts), np.concatenate(alone))


@given(scan_counts, st.integers(1, 6000))
def test_there_are_never_more_than_the_l_requested_segments(scans, segments):
    length = segment_length_for(scans, segments=segments)
    assert length == max(1, -(-scans // segments))
    assert len(cut_fixed(scans, length)) - 1 <= segments


@given(scan_counts)
def test_by_default_k_is_the_papers(scans):
    assert segment_length_for(scans) == 760


@pytest.mark.parametrize("length", [3800, 3801, 10**9, 2**63, 10**30])
def test_a_length_beyond_the_drive_makes_one_segment(length):
    assert cut_fixed(3800, segment_length_for(3800, segment_length=length)).tolist() == [0, 3800]


def test_invalid_values_are_rejected():
    with pytest.raises(EmptyDrive):
        cut_fixed(0, 5)
    for length in (0, -3):
        with pytest.raises(InvalidParameters, match=f"segment_length is {length}"):
            cut_fixed(5, length)
        with pytest.raises(InvalidParameters, match=f"segment_length is {length}"):
            segment_length_for(5, segment_length=length)
        with pytest.raises(InvalidParameters, match=f"segments is {length}"):
            segment_length_for(5, segments=length)
    with pytest.raises(InvalidParameters, match="not both"):
        segment_length_for(5, segment_length=2, segments=2)
