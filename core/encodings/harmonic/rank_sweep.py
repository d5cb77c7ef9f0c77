"""Which scan each query matches at all ranks, from the signatures of the largest ones."""

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from core.encodings.blocks import read_blocks
from core.encodings.grams import detail_gram
from core.encodings.harmonic.fit import model_of
from core.encodings.harmonic.numbers import SignatureNumbers
from core.encodings.harmonics import encode, energy, kept_ranks, sent_ranks
from core.encodings.tucker import leading_basis
from core.progress import Progress
from core.projection.imager import Views
from core.projection.images import ImageSource
from core.projection.visibility import FULL_VIEW, View, bits_of_hidden

if TYPE_CHECKING:
    from core.parameters import MapParameters


def rank_sweep(
    images: ImageSource,
    queries: Float32Array,
    cuts: Sequence[IntArray],
    ranks: tuple[Sequence[int], Sequence[int]],
    parameters: "MapParameters",
    progress: Progress,
    counted: BoolArray,
) -> tuple[IntArray, FloatArray]:
    """Return what `Encoding.rank_sweep` does; the same for all cuts, as the basis is shared.

    Basis and signatures of any ranks are the leading parts of those of the largest ones.
    """
    r1s, r2s = ranks
    most = replace(parameters, ranks=(r1s[-1], r2s[-1]))
    u, stored, hidden, squared_norm = _encoded(images, most, counted, progress)
    partial = parameters.views == Views.ANY
    views = [View.of(cells) if partial else FULL_VIEW for cells in queries]
    encoded = [
        encode(np.maximum(cells[: view.rings], 0.0), u[: view.rings], r2s[-1])
        for cells, view in zip(queries, views, strict=True)
    ]
    rows = np.zeros((len(queries), len(r1s), len(r2s)), dtype=np.int64)
    errors = np.zeros((len(r1s), len(r2s)))
    offsets_m = np.array(parameters.lateral_renderings_m)
    one_segment, of_map = np.array([0, len(images)]), hidden if partial else None
    progress.start("sweeping", rows.size)
    for (a, r1), (b, r2) in itertools.product(enumerate(r1s), enumerate(r2s)):
        tried = replace(parameters, ranks=(r1, r2))
        radial, harmonics = kept_ranks(tried)
        kept = stored[..., :radial, :harmonics]
        model = model_of(
            u[:, :radial], SignatureNumbers(kept), offsets_m, one_segment, tried, of_map
        )
        covered = float(energy(kept, parameters.grid.columns).sum())
        errors[a, b] = np.sqrt(max(0.0, 1.0 - covered / squared_norm))
        for q, (values, view) in enumerate(zip(encoded, views, strict=True)):
            sent_r1, sent_r2 = sent_ranks(tried, view)
            sent = values[:sent_r1, :sent_r2].astype(np.complex64)
            rows[q, a, b] = model.search_values(sent, view).nearest(1).rows[0]
            progress.advance()
    of_cuts = (len(cuts),)
    return (
        np.broadcast_to(rows, of_cuts + rows.shape),
        np.broadcast_to(errors, of_cuts + errors.shape),
    )


def _encoded(
    images: ImageSource, parameters: "MapParameters", counted: BoolArray, progress: Progress
) -> tuple[Float32Array, NDArray[np.complex64], IntArray, float]:
    """Return U, the signatures of all renderings, their hidden sectors, and sum |S|^2.

    Args:
        images: The scans' images.
        parameters: Those of the map.
        counted: `(K,)` which scans the basis is fitted to.
        progress: Receives every image twice.
    """
    shape, grid, (r1, r2) = parameters.imager.shape, parameters.grid, kept_ranks(parameters)
    gram, squared_norm = np.zeros((grid.rows, grid.rows)), 0.0
    progress.start("summing", 2 * len(images))
    for first, block in read_blocks(images, 0, len(images), shape, progress):
        seen = np.maximum(block, 0.0)
        these = seen[counted[first : first + len(block)]]
        gram += detail_gram(these.reshape(-1, *grid.shape))
        squared_norm += float(np.square(seen, dtype=np.float64).sum())
    u = leading_basis(gram, r1).astype(np.float32)
    signatures, hidden = [], []
    for _, block in read_blocks(images, 0, len(images), shape, progress):
        signatures.append(encode(np.maximum(block, 0.0), u, r2).astype(np.complex64))
        hidden.append(bits_of_hidden(block))
    return u, np.concatenate(signatures), np.concatenate(hidden), squared_norm
