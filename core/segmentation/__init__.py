"""Where a drive is cut into segments: fixed, as in the paper, or unequal, its future work."""

from core.segmentation.fixed import (
    PAPER_SEGMENT_LENGTH,
    cut_drives,
    cut_fixed,
    segment_length_for,
)
from core.segmentation.unequal import cut_unequal, length_limits

__all__ = [
    "PAPER_SEGMENT_LENGTH",
    "cut_drives",
    "cut_fixed",
    "cut_unequal",
    "length_limits",
    "segment_length_for",
]
