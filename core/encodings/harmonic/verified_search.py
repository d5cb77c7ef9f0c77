"""A scan query: the best candidates of its signature, compared cell by cell."""

import math
from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from core.arrays import ComplexArray, Float32Array, FloatArray, IntArray
from core.encodings.harmonic.masked_search import MaskedSearch
from core.encodings.harmonic.small_query import SmallQuery
from core.encodings.search import Search
from core.projection.probe import Displacement
from core.projection.small_image import DisplacedView
from core.projection.visibility import SECTORS, View
from core.scans.angles import wrapped_deg

if TYPE_CHECKING:
    from core.encodings.harmonic.model import HarmonicModel

_SECTOR_DEG = 360.0 / SECTORS
_BESIDE = np.array([-1, 0, 1])  # sectors around the heading that the signature found
_LATTICE = tuple(product((-1, 0, 1), (-1, 0, 1)))  # ahead, left, in metres
_HERE, _ALONG, _ACROSS = 4, [1, 4, 7], [3, 4, 5]  # in it
_MOST_STEPS = 8
_PLACES_KEPT = 256  # of 60 kB each


class VerifiedSearch(MaskedSearch):
    """An image, compared by its signature first, and the best candidates cell by cell.

    A distance is the mean of the signatures' and the images', which is 1 - correlation.
    """

    verified = True
    block_scans = 64  # in 20 MB
    most_exact = math.inf  # estimates are of signatures alone

    def __init__(
        self,
        model: "HarmonicModel",
        values: ComplexArray,
        view: View,
        cells: Float32Array,
        search_signature: Callable[[], Search] | None = None,
    ) -> None:
        super().__init__(model, values, view)
        self._query = SmallQuery(cells)
        self._search_signature = search_signature

    @cached_property
    def by_signature(self) -> Search | None:
        """The search of the signature that a vehicle would send, `None` of a map's own scan."""
        return None if self._search_signature is None else self._search_signature()

    def exact(
        self, rows: IntArray, renderings: IntArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Compare the signatures of some scans from all their viewpoints, and their images.

        Of single renderings only the signatures are compared: that chooses candidates.
        """
        distances, yaw_deg = super().exact(rows, renderings)
        if renderings is not None:
            return distances, yaw_deg
        model = self._model
        nearest = yaw_deg[np.arange(len(rows)), distances.argmin(axis=1)]
        turned = (np.rint(nearest / _SECTOR_DEG).astype(np.int64)[:, None] + _BESIDE) % SECTORS
        views = model.beside.of(model.small_images(rows))
        correlation = self._query.correlation(views, model.seen_on_line(rows), turned)
        best = correlation.max(axis=(1, 2))
        of_images = np.maximum(1.0 - best.astype(np.float64), 0.0)[:, None]
        return 0.5 * (of_images + distances), yaw_deg

    def displacement(self, row: int) -> Displacement:
        """Return where the query is relative to a scan: where their images are most alike.

        From the nearest viewpoint in steps of a metre to the place whose neighbours are all less
        alike; between places, and between headings, by the triangle through three of them.
        """
        distances, yaw_deg = self.compared(np.array([row]))
        nearest = int(distances.argmin())
        # Two of them to each side: the best may be the first or last of those that are compared.
        sectors = int(np.rint(yaw_deg[0, nearest] / _SECTOR_DEG)) + np.arange(-2, 3)
        first_left_m = float(self._model.lateral_offset_m[nearest])
        alike_at = self._alike(row, first_left_m, sectors)
        found: dict[tuple[int, int], Float32Array] = {}
        ahead = left = 0
        for _ in range(_MOST_STEPS):
            around = [(ahead + step_ahead, left + step_left) for step_ahead, step_left in _LATTICE]
            # Six of the nine were around the place before, or four.
            if new := [place for place in around if place not in found]:
                found.update(zip(new, alike_at(new), strict=True))
            alike = np.stack([found[place] for place in around])
            by_place = alike[:, 1:-1].max(axis=1)
            best = int(by_place.argmax())
            if best == _HERE:
                break
            ahead, left = around[best]
        ahead_m, left_m = float(ahead), first_left_m + left
        turned = 1 + int(alike[best, 1:-1].argmax())
        between = _peak(alike[best, turned + _BESIDE])
        if best == _HERE:
            ahead_m += _peak(by_place[_ALONG])
            left_m += _peak(by_place[_ACROSS])
        return ahead_m, left_m, wrapped_deg((float(sectors[turned]) + between) * _SECTOR_DEG)

    def _alike(
        self, row: int, left_m: float, sectors: IntArray
    ) -> Callable[[Sequence[tuple[int, int]]], Float32Array]:
        """Return what gives the correlation with a scan seen from places, `(V, H)`.

        Args:
            row: The scan's.
            left_m: What places are relative to: so far to the left of the sensor.
            sectors: `(H,)` by how many sectors the query is turned.
        """
        model, rows = self._model, np.array([row])
        grid = model.grid_shape[0], model.ring_m, model.columns
        small, left_m = model.small_images(rows), left_m - model.recorded_lateral_m
        query = self._query.in_headings(model.seen_on_line(rows), sectors[None] % SECTORS)

        def alike(places: Sequence[tuple[int, int]]) -> Float32Array:
            views = [_view_from(*grid, float(ahead), left_m + left) for ahead, left in places]
            seen = DisplacedView.concatenate(views).of(small)
            return np.asarray(query.correlation(seen)[0])

        return alike


@lru_cache(maxsize=_PLACES_KEPT)
def _view_from(
    rings: int, ring_m: float, columns: int, ahead_m: float, left_m: float
) -> DisplacedView:
    """Return the view from one place; most searches pass the same few places."""
    return DisplacedView.at(rings, ring_m, columns, np.array([ahead_m]), np.array([left_m]))


def _peak(values: Float32Array) -> float:
    """Return where values at -1, 0 and 1 are highest, within half a step.

    Cells are means over boxes, whose correlation falls to both sides as a triangle; a parabola
    would be too near to 0.

    Examples:
        >>> _peak(np.array([0.4, 0.9, 0.6], np.float32))
        0.2...
    """
    before, here, after = values.astype(np.float64).tolist()
    drop = here - min(before, after)
    return float(np.clip(0.5 * (after - before) / drop, -0.5, 0.5)) if drop > 0.0 else 0.0
