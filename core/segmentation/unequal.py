"""Segments grown while one model explains the scans: the paper's future work.

A segment grows block by block, and only its Gram matrices are in memory. For every block the
error of the model of the scans before it is divided by that model's error on its own scans. Where
the ratio is high the surroundings change, and the segment ends; it also ends where the drive turns.

In the paper's encoding the model is the paper's: both bases of the segment. In the harmonic
encoding a map has one U and fixed azimuths; there the model is the radial basis that the segment
would have, which does not depend on yaw.
"""

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.arrays import FloatArray, IntArray
from core.encodings.blocks import BLOCK_SCANS
from core.encodings.tucker import leading_basis
from core.errors import InvalidParameters
from core.numbers import require_at_least
from core.parameters import MapParameters
from core.progress import NO_PROGRESS, Progress
from core.projection.images import ImageSource
from core.scans.trajectory import Trajectory
from core.segmentation.turns import turns

SURPRISE = 1.45
"""Ratio of the errors of a block and of the scans before it, above which a segment ends:
docs/decisions/0013-unequal-segments-and-topology.md."""
_ROUNDING = 1e-6  # of an error: what is below, as of all ranks that images have, says nothing


def length_limits(segment_length: int) -> tuple[int, int]:
    """Return how many scans an unequal segment has at least and at most: k/2, rounded up, and 2k.

    Raises:
        InvalidParameters: If the length is below 1.

    Examples:
        >>> length_limits(760), length_limits(1)
        ((380, 1520), (1, 2))
    """
    require_at_least(1, segment_length=segment_length)
    return math.ceil(segment_length / 2), 2 * segment_length


def cut_unequal(
    images: ImageSource,
    trajectory: Trajectory,
    segment_length: int,
    parameters: MapParameters,
    progress: Progress = NO_PROGRESS,
) -> IntArray:
    """Cut every drive where its surroundings change or it turns, `(L + 1,)` starts and the end.

    A segment has k/2 to 2k scans; only a drive shorter than that is one by itself. It ends at the
    first block that is a surprise, or at a turn before, or at 2k. Images are read block by block.

    Args:
        images: One image a scan of the trajectory, or its renderings: the one nearest to the line
            counts.
        trajectory: The trajectory of all drives. Turns are known by poses only.
        segment_length: k.
        parameters: Encoding and ranks of the model.
        progress: Receives every image; may raise `Cancelled`.

    Raises:
        InvalidParameters: If the length is below 1, or images and trajectory do not fit together.
    """
    if len(images) != len(trajectory):
        raise InvalidParameters(
            f"{len(images)} images and {len(trajectory)} scans do not fit together"
        )
    limits = length_limits(segment_length)
    corners = turns(trajectory)
    progress.start("segmenting", len(images))
    reader = _Reader(images, parameters, progress)
    cuts: list[int] = []
    for start, end in itertools.pairwise(trajectory.drive_start.tolist()):
        cuts += _cut_drive(reader, start, end, limits, corners)
    return np.array([*cuts, len(trajectory)], dtype=np.int64)


def _cut_drive(
    reader: "_Reader", start: int, end: int, limits: tuple[int, int], corners: IntArray
) -> list[int]:
    """Return where the segments of a drive begin."""
    shortest, longest = limits
    block_scans = max(1, min(BLOCK_SCANS, shortest // 4))
    cuts = [start]
    while end - start >= 2 * shortest:
        # The rest behind a cut must have the shortest length of a segment.
        first, last = start + shortest, min(start + longest, end - shortest)
        corner = corners[(corners >= first) & (corners <= last)]
        last = int(corner[0]) if len(corner) else last
        cut = _first_surprise(reader, start, first, last, block_scans)
        if cut is None and not len(corner) and end - start <= longest:
            break  # one model fits the rest
        start = last if cut is None else cut
        cuts.append(start)
    reader.skip_to(end)
    return cuts


def _first_surprise(
    reader: "_Reader", start: int, first: int, last: int, block_scans: int
) -> int | None:
    """Grow a segment from `start`; return where, from `first` up to `last`, it ends."""
    grown = reader.grams(start, first)
    at = first
    while at < last:
        stop = min(at + block_scans, last)
        block = reader.grams(at, stop)
        bases = grown.bases()
        if block.error(bases) > SURPRISE * max(grown.error(bases), _ROUNDING):
            return at
        grown += block
        at = stop
    return None


@dataclass(frozen=True, eq=False)
class _Explained:
    """Gram matrices of some scans, one for each mode that a segment has a basis of."""

    grams: tuple[FloatArray, ...]
    ranks: tuple[int, ...]

    def __add__(self, other: "_Explained") -> "_Explained":
        summed = tuple(a + b for a, b in zip(self.grams, other.grams, strict=True))
        return _Explained(summed, self.ranks)

    def bases(self) -> list[FloatArray]:
        """Return the bases of these scans."""
        return [leading_basis(g, r) for g, r in zip(self.grams, self.ranks, strict=True)]

    def error(self, bases: list[FloatArray]) -> float:
        """Return the relative error of these scans in some bases, at most.

        |X - X^|^2 is no more than what each basis leaves out by itself, summed.
        """
        squared_norm = float(np.trace(self.grams[0]))
        if squared_norm <= 0.0:
            return 0.0
        kept = [float(((g @ b) * b).sum()) for g, b in zip(self.grams, bases, strict=True)]
        return math.sqrt(sum(max(0.0, 1.0 - one / squared_norm) for one in kept))


class _Reader:
    """Reads images as Gram matrices, those of one segment once."""

    def __init__(self, images: ImageSource, parameters: MapParameters, progress: Progress) -> None:
        self._images = images
        self._progress = progress
        self._ranks = parameters.ranks
        self._encoder = parameters.encoder
        offsets = parameters.lateral_renderings_m
        self._rendering = None if offsets is None else int(np.abs(offsets).argmin())
        self._reported = 0

    def grams(self, start: int, stop: int) -> _Explained:
        """Return the Gram matrices of scans `start` up to `stop`."""
        total: _Explained | None = None
        for at in range(start, stop, BLOCK_SCANS):
            block = self._of(self._images.read(at, min(at + BLOCK_SCANS, stop)))
            total = block if total is None else total + block
        self.skip_to(stop)
        return total if total is not None else self._of(self._images.read(start, start))

    def skip_to(self, row: int) -> None:
        """Report progress up to a row."""
        if row > self._reported:
            self._progress.advance(row - self._reported)
            self._reported = row

    def _of(self, block: NDArray[Any]) -> _Explained:
        images = block if self._rendering is None else block[:, self._rendering]
        grams = self._encoder.explaining_grams(images)
        return _Explained(grams, self._ranks[: len(grams)])
