"""Many maps' places in one index: the few hundred that a query may be of, then compared exactly.

All places are ranked by the loop that searches large maps, with all waves in phase; the best of
these in few headings, in the rendering that was most alike; then these renderings exactly, and last
all renderings of the best, with their verification images if a scan is searched
(docs/decisions/0035-where-among-all-maps.md).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from core.arrays import Complex64Array, Float32Array, FloatArray, IntArray
from core.encodings.basis import Basis
from core.encodings.distance import Distance
from core.encodings.harmonic.basis import HarmonicBasis
from core.encodings.harmonic.codes import SignatureCodes
from core.encodings.harmonic.in_phase import best_in_phase
from core.encodings.harmonic.indexed_places import (
    RENDERINGS,
    HarmonicPlaces,
    Int8Array,
    beside,
    joined,
)
from core.encodings.harmonic.masked_search import MaskedSearch
from core.encodings.harmonic.model import HarmonicModel
from core.encodings.harmonic.renderings import LEAST_SEEN
from core.encodings.harmonic.window import Window
from core.encodings.harmonics import encode, kept_ranks, sent_ranks, two_sided, weights
from core.encodings.model import Model
from core.encodings.place_index import PlaceIndex
from core.encodings.signature import Signature
from core.errors import InvalidMap
from core.projection.imager import Image, Views
from core.projection.rings import RingGrid
from core.projection.visibility import FULL_VIEW, SECTORS, View

if TYPE_CHECKING:
    from core.parameters import MapParameters

_MIXED = 2  # harmonics beyond those that are sent, which a mask mixes into them: with more, worse
_FEW_HIDDEN = 6  # sectors: with more, more places are as much alike
_PLACES_A_CHOSEN, _LEAST_CHOSEN, _MOST_CHOSEN = 50, 6000, 20_000  # compared in few headings
_OF_PARTIAL, _MOST_OF_PARTIAL = 2, 28_000  # times as many, of which more are compared exactly
_HEADINGS, _HEADINGS_OF_SCAN = 32, 64  # the latter for more harmonics
_ONE_EXACT, _ALL_EXACT = 640, 96  # places of which one rendering is compared exactly, and all
_ONE_EXACT_OF_PARTIAL = 1500
# With all kept numbers fewer places are as much alike.
_MOST_OF_SCAN, _ONE_EXACT_OF_SCAN = 10_000, 320
_AT_ONCE = 2048  # renderings in few headings, in the processor's cache
_COUNTED_AT_ONCE = 1024  # places whose energies are computed


class _Steps(NamedTuple):
    """How much the steps of a search compare.

    Attributes:
        chosen: Places in few headings.
        headings: How many these are.
        exact: Places of which one rendering is compared exactly.
    """

    chosen: int
    headings: int
    exact: int

    @classmethod
    def of(cls, places: int, view: View, *, of_scan: bool) -> "_Steps":
        """Return those of a query of so many places."""
        most = _MOST_OF_SCAN if of_scan else _MOST_CHOSEN
        chosen = min(max(places // _PLACES_A_CHOSEN, _LEAST_CHOSEN), most)
        exact = _ONE_EXACT_OF_SCAN if of_scan else _ONE_EXACT
        if len(view.hidden) > _FEW_HIDDEN or view.rings is not None:
            chosen, exact = min(_OF_PARTIAL * chosen, _MOST_OF_PARTIAL), _ONE_EXACT_OF_PARTIAL
        return cls(chosen, _HEADINGS_OF_SCAN if of_scan else _HEADINGS, exact)


@dataclass(frozen=True, eq=False)
class HarmonicPlaceIndex(PlaceIndex[HarmonicPlaces]):
    """How the places of all maps of one basis are indexed and found.

    Attributes:
        basis: Of the maps.
    """

    basis: HarmonicBasis

    @classmethod
    def of(cls, basis: Basis) -> "HarmonicPlaceIndex":
        """Return the index for maps of a basis.

        Raises:
            InvalidMap: If it is of another encoding.
        """
        if not isinstance(basis, HarmonicBasis):
            raise InvalidMap(f"a {basis.parameters.encoding} basis has no harmonic index")
        return cls(basis)

    @property
    def parameters(self) -> "MapParameters":
        """Of one of the maps; what signatures depend on is the same in all."""
        return self.basis.parameters

    def entries(self, models: Sequence[Model]) -> HarmonicPlaces:
        """Return the entries of all scans of some maps."""
        return joined([self._of_model(one) for one in models if isinstance(one, HarmonicModel)])

    def joined(self, parts: Sequence[HarmonicPlaces]) -> HarmonicPlaces:
        """Return the places of some entries, one after another."""
        return joined(parts)

    def read(self, arrays: Mapping[str, NDArray[Any]]) -> HarmonicPlaces:
        """Return stored entries of these `arrays`."""
        entries = HarmonicPlaces(**arrays)
        r1, r2 = kept_ranks(self.parameters)
        places = len(entries)
        wanted: dict[str, tuple[tuple[int, ...], Any]] = {
            "codes": ((2 * r2 - 1, r1, RENDERINGS, places), np.int8),
            "scales": ((places, RENDERINGS), np.float32),
            "factors": ((len(compared_ranks(self.parameters)), RENDERINGS, places), np.float32),
            "hidden": ((places, RENDERINGS), np.int64),
            "images": ((places, self._image_rings, SECTORS), np.uint8),
        }
        for name, array in arrays.items():
            shape, dtype = wanted[name]
            if array.shape != shape or array.dtype != dtype:
                raise InvalidMap(f"{name} of an index is {array.dtype} {array.shape}")
        return entries

    def _of_model(self, model: HarmonicModel) -> HarmonicPlaces:
        stored = model.stored.as_codes()  # `signatures` would be kept
        kept = beside(model.lateral_offset_m)
        codes, scales = stored.codes[:, :, kept], stored.scales[:, kept]
        hidden = np.zeros(scales.shape, np.int64)
        if model.hidden_sectors is not None:
            hidden = model.hidden_sectors[:, kept]
        factors = np.empty(
            (len(compared_ranks(self.parameters)), RENDERINGS, len(model)), np.float32
        )
        for start in range(0, len(model), _COUNTED_AT_ONCE):
            block = slice(start, start + _COUNTED_AT_ONCE)
            factors[..., block] = self._factors(codes[..., block])
        images = np.zeros((len(model), self._image_rings, SECTORS), np.uint8)
        if model.verification_images is not None and self._image_rings:
            images[...] = model.verification_images
        return HarmonicPlaces(np.ascontiguousarray(codes), scales, factors, hidden, images)

    @property
    def _image_rings(self) -> int:
        return self.parameters.grid.rows if self.parameters.verification_images else 0

    def _factors(self, codes: Int8Array) -> FloatArray:
        """Return one through the norm of the first numbers, and a part of that of all."""
        squared = np.square(codes, dtype=np.float32)
        squared[1::2] += squared[2::2]
        by_harmonic = np.concatenate([squared[:1], squared[1::2]]).astype(np.float64)
        by_harmonic *= weights(self.parameters.grid.columns, len(by_harmonic))[:, None, None, None]
        least = LEAST_SEEN * by_harmonic.sum(axis=(0, 1))
        found = [
            by_harmonic[:r2, :r1].sum(axis=(0, 1)) + least
            for r1, r2 in compared_ranks(self.parameters)
        ]
        return np.asarray(1.0 / np.sqrt(np.maximum(found, 1.0)))  # of no number it is not used

    def nearest(
        self,
        query: Signature | Image,
        searched: Sequence[tuple[HarmonicPlaces, IntArray | None]],
    ) -> list[tuple[IntArray, FloatArray]]:
        """Rank all places with the waves in phase, then fewer and fewer ever more exactly."""
        image = query if isinstance(query, Image) else None
        signature = self._all_numbers(query) if isinstance(query, Image) else query
        multiplied = self._query(signature)
        ranks = self._ranks_of(multiplied)
        spans = [_spans(entries, some) for entries, some in searched]
        found = [
            best_in_phase(
                entries.codes[:, : len(multiplied)], multiplied, entries.factors[ranks], some
            )
            for (entries, _), some in zip(searched, spans, strict=True)
        ]
        counts = [len(alike) for alike, _ in found]
        number = np.repeat(np.arange(len(found)), counts)
        alike = np.concatenate([alike for alike, _ in found])
        steps = _Steps.of(len(alike), signature.view, of_scan=image is not None)
        kept = np.sort(_most(alike, steps.chosen))
        candidates = []
        for at, ((entries, _), some) in enumerate(zip(searched, spans, strict=True)):
            rows = kept[number[kept] == at] - sum(counts[:at])
            rendering = found[at][1][rows].astype(np.int64)
            candidates.append((entries, _places(some, rows), rendering))
        scores = np.concatenate(
            [
                self._in_headings(multiplied, steps.headings, entries, *which)
                for entries, *which in candidates
            ]
        )
        left = np.sort(_most(scores, steps.exact))
        end = np.cumsum([0, *(len(places) for _, places, _ in candidates)])
        some_of = [
            (entries, places[rows], rendering[rows])
            for at, (entries, places, rendering) in enumerate(candidates)
            for rows in [left[(left >= end[at]) & (left < end[at + 1])] - end[at]]
        ]
        return self._exact(signature, image, some_of)

    def _all_numbers(self, image: Image) -> Signature:
        """Return an image's signature of as many numbers as maps keep."""
        near, r2 = slice(image.view.rings), kept_ranks(self.parameters)[1]
        values = encode(image.seen[near], self.basis.radial_basis[near], r2)
        return Signature(values.astype(np.complex64), None, self.basis.digest, view=image.view)

    def _query(self, signature: Signature) -> Complex64Array:
        """Return what multiplies a rendering's numbers, `(r1, m)`.

        Of a partial view what its scan would have seen of a rendering is compared, each mixture of
        harmonics as much as the window leaves of it (`masked_search`).
        """
        columns, values = self.parameters.grid.columns, signature.values.astype(np.complex128)
        if signature.view.hidden:
            kept = max(kept_ranks(self.parameters)[1], values.shape[1])
            window = Window(signature.view, columns, values.shape[1])
            count = min(kept, values.shape[1] + _MIXED)
            within = two_sided(values) @ window.evening.T @ window.evening.conj()
            values = (within @ window.mixing(count).conj())[:, count - 1 :]
        weighted = values * weights(columns, values.shape[1])
        return np.asarray(weighted.astype(np.complex64))

    def _ranks_of(self, query: Complex64Array) -> int:
        """Return which of `compared_ranks` is nearest to those of a query."""
        r1, m = query.shape
        apart = [abs(r1 - one) + abs(m - other) for one, other in compared_ranks(self.parameters)]
        return int(np.argmin(apart))

    def _in_headings(
        self,
        query: Complex64Array,
        headings: int,
        entries: HarmonicPlaces,
        places: IntArray,
        renderings: IntArray,
    ) -> Float32Array:
        """Return the correlation of a rendering of each place in the best heading, `(n,)`."""
        r1, count = query.shape
        turns = np.exp(2j * np.pi / headings * np.outer(np.arange(headings), np.arange(count)))
        turned = query.T * turns[..., None]  # (headings, m, r1)
        products = np.empty((headings, 2 * count - 1, r1), np.float32)
        products[:, 0], products[:, 1::2] = turned.real[:, 0], turned.real[:, 1:]
        products[:, 2::2] = turned.imag[:, 1:]
        products = products.reshape(headings, -1)
        codes = np.asarray(entries.codes)[: 2 * count - 1, :r1]
        best = np.empty(len(places), np.float32)
        for start in range(0, len(places), _AT_ONCE):
            block = slice(start, start + _AT_ONCE)
            numbers = codes[:, :, renderings[block], places[block]].astype(np.float32)
            best[block] = (products @ numbers.reshape(products.shape[1], -1)).max(axis=0)
        best *= np.asarray(entries.factors)[self._ranks_of(query), renderings, places]
        return best

    def _exact(
        self,
        signature: Signature,
        image: Image | None,
        found: Sequence[tuple[HarmonicPlaces, IntArray, IntArray]],
    ) -> list[tuple[IntArray, FloatArray]]:
        """Compare one rendering of each place as a map does, and all of those of the best."""
        of_parts = [entries.at(places) for entries, places, _ in found]
        codes = SignatureCodes(
            np.concatenate([one.codes for one, _ in of_parts], axis=-1),
            np.concatenate([one.scales for one, _ in of_parts]),
        )
        hidden = np.concatenate([one for _, one in of_parts])
        rendering = np.concatenate([one for _, _, one in found])
        search = self._model(codes, hidden).search_values(signature.values, signature.view)
        rows = np.arange(len(rendering))
        if isinstance(search, MaskedSearch) and len(rows) > _ALL_EXACT:
            of_one, _ = search.exact(rows, rendering[:, None])
            rows = np.sort(_most(-of_one[:, 0], _ALL_EXACT))
        ends = np.cumsum([len(places) for _, places, _ in found])
        compared = [
            places[rows[(rows >= end - len(places)) & (rows < end)] - (end - len(places))]
            for (_, places, _), end in zip(found, ends, strict=True)
        ]
        images = np.concatenate(
            [
                np.asarray(entries.images)[places]
                for (entries, _, _), places in zip(found, compared, strict=True)
            ]
        )
        if image is not None and images.any(axis=(1, 2)).all():
            model = self._model(codes.select(rows), hidden[rows], images)
            distances = model.search_image(image, self.basis).distances_of(np.arange(len(rows)))
        else:
            distances = search.distances_of(rows)
        of_each = np.split(distances, np.cumsum([len(places) for places in compared])[:-1])
        return list(zip(compared, of_each, strict=True))

    def _model(
        self, codes: SignatureCodes, hidden: IntArray, images: NDArray[np.uint8] | None = None
    ) -> HarmonicModel:
        """Return a map of some places."""
        grid = self.parameters.grid
        offset_m = np.asarray(self.parameters.lateral_renderings_m or (0.0,))
        return HarmonicModel(
            self.basis.radial_basis,
            codes,
            offset_m[beside(offset_m)],
            np.array([0, len(hidden)]),
            grid.columns,
            Distance.NORMALISED,
            self.parameters.ranks,
            None if self.parameters.views == Views.FULL else hidden,
            images,
            grid.ring_m if isinstance(grid, RingGrid) else 1.0,
        )


def compared_ranks(parameters: "MapParameters") -> list[tuple[int, int]]:
    """Return of how many numbers norms are kept: those that queries are compared by.

    Examples:
        >>> from core.parameters import MapParameters
        >>> compared_ranks(MapParameters.for_sensor(ranks=(6, 7), views=Views.ANY))
        [(6, 7), (6, 9), (8, 5), (8, 7), (10, 12)]
    """
    kept = kept_ranks(parameters)
    sent = {sent_ranks(parameters, view) for view in (FULL_VIEW, View(tuple(range(SECTORS // 3))))}
    mixed = {(r1, min(kept[1], r2 + more)) for r1, r2 in sent for more in (0, _MIXED)}
    return sorted({*mixed, kept})


def _spans(entries: HarmonicPlaces, spans: IntArray | None) -> IntArray:
    return np.array([[0, len(entries)]]) if spans is None else spans


def _places(spans: IntArray, rows: IntArray) -> IntArray:
    """Return the places of rows of some ranges one after another."""
    lengths = spans[:, 1] - spans[:, 0]
    before = np.cumsum(lengths) - lengths
    of_span = np.searchsorted(before + lengths, rows, side="right")
    return np.asarray(rows - before[of_span] + spans[of_span, 0])


def _most(values: NDArray[Any], count: int) -> IntArray:
    """Return which values are the largest, in no order."""
    if len(values) <= count:
        return np.arange(len(values))
    return np.argpartition(values, len(values) - count)[len(values) - count :]
