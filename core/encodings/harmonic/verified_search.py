"""A scan query: the best candidates of its signature, compared cell by cell."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from core.arrays import ComplexArray, Float32Array, FloatArray, IntArray
from core.encodings.harmonic.masked_search import MaskedSearch
from core.encodings.harmonic.small_query import SmallQuery
from core.projection.visibility import SECTORS

if TYPE_CHECKING:
    from core.encodings.harmonic.model import HarmonicModel

_OF_SIGNATURE = 2.0  # the weight of its distance; that of the images counts once
_SECTOR_DEG = 360.0 / SECTORS
_BESIDE = np.array([-1, 0, 1])  # sectors around the heading that the signature found


class VerifiedSearch(MaskedSearch):
    """An image, compared by its signature first, and the best candidates cell by cell.

    A distance is a third of the images', 1 - correlation, and two thirds of the signatures'.
    """

    verified = True

    def __init__(
        self,
        model: "HarmonicModel",
        values: ComplexArray,
        hidden: Sequence[int],
        cells: Float32Array,
    ) -> None:
        super().__init__(model, values, hidden)
        self._query = SmallQuery(cells)

    def exact(self, rows: IntArray) -> tuple[FloatArray, FloatArray]:
        """Compare the signatures and images of some scans, from all their viewpoints."""
        distances, yaw_deg = super().exact(rows)
        model = self._model
        nearest = yaw_deg[np.arange(len(rows)), distances.argmin(axis=1)]
        turned = (np.rint(nearest / _SECTOR_DEG).astype(np.int64)[:, None] + _BESIDE) % SECTORS
        views = model.beside.of(model.small_images(rows))
        correlation = self._query.correlation(views, model.seen_on_line(rows))
        best = np.take_along_axis(correlation, turned[:, None], axis=2).max(axis=2)
        of_images = np.maximum(1.0 - best.astype(np.float64), 0.0)
        return (of_images + _OF_SIGNATURE * distances) / (1.0 + _OF_SIGNATURE), yaw_deg
