"""Accuracy of the paper's encoding for every {r1, r2, k}, by partial sums (paper, fig. 4).

Bases of all ranks come from one eigendecomposition, and the signature at ranks (r1, r2) is the
leading block of that at larger ranks. So squared distances at all ranks are partial sums of one
squared difference, and images are encoded once a segment length, not once a candidate.
"""

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from core.arrays import Float32Array, FloatArray, IntArray
from core.encodings.blocks import read_blocks
from core.encodings.tucker import Grams, leading_basis, project
from core.progress import Progress
from core.projection.images import ImageSource

if TYPE_CHECKING:
    from core.parameters import MapParameters


def leading_sums(blocks: FloatArray, r1: Sequence[int], r2: Sequence[int]) -> FloatArray:
    """Return sums over the leading r1 x r2 block of `(..., R1, R2)`, for all `r1` and `r2`.

    Examples:
        >>> leading_sums(np.ones((4, 6)), [1, 3], [2, 6]).tolist()
        [[2.0, 6.0], [6.0, 18.0]]
    """
    within = blocks[..., : r1[-1], : r2[-1]]
    parts = np.add.reduceat(within, [0, *r1[:-1]], axis=-2)
    parts = np.add.reduceat(parts, [0, *r2[:-1]], axis=-1)
    return np.asarray(parts.cumsum(axis=-2).cumsum(axis=-1))


def sweep(
    images: ImageSource,
    queries: Float32Array,
    cuts: Sequence[IntArray],
    ranks: tuple[Sequence[int], Sequence[int]],
    parameters: "MapParameters",
    progress: Progress,
) -> tuple[IntArray, FloatArray]:
    """Return the nearest row of every query and the relative errors: `Encoding.rank_sweep`."""
    del parameters
    r1, r2 = ranks
    counts = (len(r1), len(r2))
    rows = np.zeros((len(cuts), len(queries), *counts), dtype=np.int64)
    errors = np.zeros((len(cuts), *counts))
    atoms = np.unique(np.concatenate(cuts))
    progress.start("summing", int(atoms[-1]))
    grams = []
    for start, end in itertools.pairwise(atoms.tolist()):
        total = Grams.zero(images.grid.shape)
        for _, block in read_blocks(images, start, end, images.grid.shape, progress):
            total += Grams.of(block)
        grams.append(total)
    progress.start("sweeping", len(cuts) * int(atoms[-1]))
    for i, cut in enumerate(cuts):
        best = np.full((len(queries), *counts), np.inf)
        kept, squared_norm = np.zeros(counts), 0.0
        for start, end in itertools.pairwise(cut.tolist()):
            first, last = np.searchsorted(atoms, [start, end])
            total = sum(grams[first + 1 : last], grams[first])
            squared_norm += total.squared_norm
            # In single precision, as a map keeps them.
            u = leading_basis(total.elevation, r1[-1]).astype(np.float32).astype(np.float64)
            v = leading_basis(total.azimuth, r2[-1]).astype(np.float32).astype(np.float64)
            stored = project(images.read(start, end), u, v).astype(np.float32)
            kept += leading_sums(np.square(stored, dtype=np.float64).sum(axis=0), r1, r2)
            for q, signature in enumerate(project(queries, u, v).astype(np.float32)):
                squared = leading_sums(np.square(stored - signature), r1, r2)
                nearest = squared.argmin(axis=0)
                distance = np.take_along_axis(squared, nearest[None], axis=0)[0]
                closer = distance < best[q]
                best[q][closer] = distance[closer]
                rows[i, q][closer] = start + nearest[closer]
            progress.advance(end - start)
        errors[i] = np.sqrt(np.maximum(0.0, 1.0 - kept / squared_norm))
    return rows, errors
