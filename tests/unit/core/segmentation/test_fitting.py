"""Segments that fit the length of a drive."""

import math

import pytest

from core.errors import InvalidParameters
from core.segmentation.fitting import fitting_length, require_segments
from core.segmentation.fixed import PAPER_SEGMENT_LENGTH, cut_fixed


@pytest.mark.parametrize(
    ("scans", "path_m", "segments"),
    [
        (250, 443.0, 4),  # at the paper's k: one segment, two nodes
        (250, math.nan, 3),
        (60, 90.0, 1),
        (60, 0.0, 1),  # a stop
        (1, 0.0, 1),
        (3800, 3_724.0, 5),  # the paper's
        (20_000, 18_000.0, 26),
    ],
)
def test_a_short_drive_has_some_segments_and_a_long_one_those_of_the_paper(scans, path_m, segments):
    length = fitting_length(scans, path_m)
    assert 1 <= length <= PAPER_SEGMENT_LENGTH
    assert len(cut_fixed(scans, length)) - 1 == segments


def test_segments_of_one_scan_are_rejected():
    require_segments(0, segment_length=None, segments=None)
    require_segments(1, segment_length=None, segments=1)
    require_segments(1, segment_length=1, segments=None)
    require_segments(300, segment_length=None, segments=150)
    require_segments(300, segment_length=2, segments=None)
    with pytest.raises(InvalidParameters, match=r"segments is 5000.*300 scans.*at most 150"):
        require_segments(300, segment_length=None, segments=5000)
    with pytest.raises(InvalidParameters, match=r"segment_length is 1.*300 scans.*at least 2"):
        require_segments(300, segment_length=1, segments=None)
