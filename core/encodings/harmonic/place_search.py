"""The search of one query among the indexed places of many maps.

Each step compares fewer places more exactly (docs/decisions/0035-where-among-all-maps.md): all of
them with the waves in phase, by a part of the numbers; the best in few headings, in the rendering
that was most alike; that rendering exactly, by all numbers; and last all renderings, and the
verification images if a scan is searched. Parts of the index are read by as many threads as there
are cores.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from core.arrays import Complex64Array, Float32Array, FloatArray, IntArray
from core.encodings.distance import Distance
from core.encodings.harmonic.basis import HarmonicBasis
from core.encodings.harmonic.codes import SignatureCodes, waves_of
from core.encodings.harmonic.in_phase import best_rendering_in_phase
from core.encodings.harmonic.indexed_places import HarmonicPlaces, Int8Array, beside
from core.encodings.harmonic.model import HarmonicModel
from core.encodings.harmonic.window import window_of
from core.encodings.harmonics import kept_ranks, sent_ranks, two_sided, weights
from core.encodings.signature import Signature
from core.parallel import in_threads
from core.projection.imager import Image, Views
from core.projection.rings import RingGrid
from core.projection.visibility import FULL_VIEW, SECTORS, View

if TYPE_CHECKING:
    from core.parameters import MapParameters

_MIXED = 2  # harmonics beyond those that are sent, which a mask mixes into them: with more, worse
_FEW_HIDDEN = 6  # sectors: with more, more places are as much alike
_NARROW = View(tuple(range(SECTORS // 3)))
_HEADINGS = 64
_PLACES_A_CHOSEN, _LEAST_CHOSEN = 35, 6000  # compared in few headings
_ALL_EXACT = 96  # places of which all renderings are compared exactly
_AT_ONCE = 2048  # renderings in few headings, in the processor's cache
_EXACT_ONCE = 240  # renderings compared exactly, likewise
_SAMPLED = 16_384  # of many values, by which the largest are found


class Effort(NamedTuple):
    """How much the steps of a search compare.

    Attributes:
        ranks: Most numbers that are compared of all places, and in few headings.
        in_headings: Most places in few headings.
        exact: Places of which one rendering is compared exactly, with all numbers.
    """

    ranks: tuple[int, int]
    in_headings: int
    exact: int

    @classmethod
    def of(cls, parameters: "MapParameters", view: View) -> "Effort":
        """Return that of a query: the less it sees of a place, the more places are compared."""
        full, few, many = _phase_ranks(parameters)
        if len(view.hidden) > _FEW_HIDDEN or view.rings is not None:
            return cls(many, 20_000, 2000)
        return cls(few if view.hidden else full, 20_000, 640)


def _phase_ranks(parameters: "MapParameters") -> tuple[tuple[int, int], ...]:
    """Return the most numbers that are compared in phase, of full, nearly full and partial views.

    Examples:
        >>> from core.parameters import MapParameters
        >>> _phase_ranks(MapParameters.for_sensor(ranks=(6, 7), views=Views.ANY))
        ((6, 7), (8, 9), (8, 12))
    """
    full, (r1, _) = sent_ranks(parameters, FULL_VIEW), sent_ranks(parameters, _NARROW)
    kept = kept_ranks(parameters)[1]
    return full, (r1, min(kept, full[1] + _MIXED)), (r1, kept)


def compared_ranks(parameters: "MapParameters") -> list[tuple[int, int]]:
    """Return of how many numbers norms are kept: those that queries are compared by.

    Examples:
        >>> from core.parameters import MapParameters
        >>> compared_ranks(MapParameters.for_sensor(ranks=(6, 7), views=Views.ANY))
        [(6, 7), (6, 9), (8, 5), (8, 7), (8, 9), (8, 12)]
    """
    kept = kept_ranks(parameters)[1]
    sent = {sent_ranks(parameters, view) for view in (FULL_VIEW, _NARROW)}
    mixed = {(r1, min(kept, r2 + more)) for r1, r2 in sent for more in (0, _MIXED)}
    return sorted({*mixed, *_phase_ranks(parameters)})


@dataclass(frozen=True, eq=False)
class _Candidates:
    """Some places, in their order, and one rendering of each.

    Attributes:
        part: `(n,)` the part of the index that each is in, rising.
        place: `(n,)` in it, rising.
        rendering: `(n,)`.
    """

    part: IntArray
    place: IntArray
    rendering: IntArray

    def __len__(self) -> int:
        return len(self.part)

    def most(self, alike: NDArray[Any], count: int) -> "_Candidates":
        """Return those that are most alike, at most so many."""
        rows = np.sort(most(alike, count))
        return _Candidates(self.part[rows], self.place[rows], self.rendering[rows])

    def of_part(self, part: int) -> slice:
        """Return which of them are in a part."""
        start, end = np.searchsorted(self.part, [part, part + 1])
        return slice(int(start), int(end))


class PlaceSearch:
    """One query, compared with indexed places.

    Args:
        basis: The basis of their maps.
        query: A signature of this basis, or an image on its grid.
        parts: Places, and the ranges of those that may be found; `None` of all.
    """

    def __init__(
        self,
        basis: HarmonicBasis,
        query: Signature | Image,
        parts: Sequence[tuple[HarmonicPlaces, IntArray | None]],
    ) -> None:
        self._basis, self._parameters = basis, basis.parameters
        self._image = query if isinstance(query, Image) else None
        self._signature = _all_numbers(basis, query) if isinstance(query, Image) else query
        self._parts = [entries for entries, _ in parts]
        self._spans = [
            np.array([[0, len(entries)]]) if some is None else some for entries, some in parts
        ]
        self._effort = Effort.of(self._parameters, self._signature.view)
        r1, m = self._effort.ranks
        self._query = np.ascontiguousarray(self._multiplied()[:r1, :m])
        self._ranks = _nearest_ranks(self._parameters, self._query)

    def nearest(self) -> list[tuple[IntArray, FloatArray]]:
        """Return the places of each part that were compared exactly, and their distances."""
        candidates = self._in_phase()
        candidates = candidates.most(self._in_headings(candidates), self._effort.exact)
        if len(candidates) > _ALL_EXACT:
            candidates = candidates.most(-self._of_one(candidates), _ALL_EXACT)
        distances = self._of_all(candidates)
        of_parts = [candidates.of_part(number) for number in range(len(self._parts))]
        return [(candidates.place[some], distances[some]) for some in of_parts]

    def _multiplied(self) -> Complex64Array:
        """Return what multiplies a rendering's numbers, `(r1, m)`.

        Of a partial view what its scan would have seen of a rendering is compared, each mixture of
        harmonics as much as the window leaves of it (`masked_search`).
        """
        view, columns = self._signature.view, self._parameters.grid.columns
        values = self._signature.values.astype(np.complex128)
        if view.hidden:
            kept = max(kept_ranks(self._parameters)[1], values.shape[1])
            window = window_of(view, columns, values.shape[1])
            count = min(kept, values.shape[1] + _MIXED)
            within = two_sided(values) @ window.evening.T @ window.evening.conj()
            values = (within @ window.mixing(count).conj())[:, count - 1 :]
        weighted = values * weights(columns, values.shape[1])
        return np.asarray(weighted.astype(np.complex64))

    def _in_phase(self) -> _Candidates:
        """Return the places that are most alike with all waves in phase."""
        found = in_threads(self._part_in_phase, range(len(self._parts)))
        alike = np.concatenate([of_part for of_part, _ in found])
        count = max(len(alike) // _PLACES_A_CHOSEN, _LEAST_CHOSEN)
        kept = np.sort(most(alike, min(count, self._effort.in_headings)))
        ends = np.cumsum([len(of_part) for of_part, _ in found])
        part = np.searchsorted(ends, kept, side="right")
        places, renderings = [], []
        for number, (spans, (of_part, which)) in enumerate(zip(self._spans, found, strict=True)):
            rows = kept[part == number] - (ends[number] - len(of_part))
            places.append(_places(spans, rows))
            renderings.append(which[rows].astype(np.int64))
        return _Candidates(part, np.concatenate(places), np.concatenate(renderings))

    def _part_in_phase(self, part: int) -> tuple[Float32Array, Int8Array]:
        query, entries = self._query, self._parts[part]
        codes, factors = entries.codes[:, : len(query)], entries.factors[self._ranks]
        return best_rendering_in_phase(codes, query, factors, self._spans[part])

    def _in_headings(self, candidates: _Candidates) -> Float32Array:
        """Return the correlation of each rendering in the best heading, `(n,)`."""
        query = self._query
        r1, m = query.shape
        angles = 2.0 * np.pi / _HEADINGS * np.outer(np.arange(_HEADINGS), np.arange(m))
        in_headings = np.stack([np.cos(angles), -np.sin(angles)], axis=2).astype(np.float32)
        in_headings = in_headings.reshape(_HEADINGS, -1)
        best = np.empty(len(candidates), np.float32)

        def compare(part: int) -> None:
            entries, whole = self._parts[part], candidates.of_part(part)
            codes, factors = np.asarray(entries.codes), np.asarray(entries.factors[self._ranks])
            for start in range(whole.start, whole.stop, _AT_ONCE):
                block = slice(start, min(start + _AT_ONCE, whole.stop))
                which = candidates.rendering[block], candidates.place[block]
                waves = waves_of(codes[(slice(2 * m - 1), slice(r1), *which)], query)
                alike = (in_headings @ waves.reshape(2 * m, -1)).max(axis=0)
                best[block] = alike * factors[which]

        in_threads(compare, range(len(self._parts)))
        return best

    def _of_one(self, candidates: _Candidates) -> FloatArray:
        """Compare the one rendering of each place as a map does, `(n,)`."""
        codes, scales, hidden = [], [], []
        for number, entries in enumerate(self._parts):
            some = candidates.of_part(number)
            place, rendering = candidates.place[some], candidates.rendering[some]
            codes.append(np.asarray(entries.codes)[:, :, rendering, place])
            scales.append(np.asarray(entries.scales)[place, rendering])
            hidden.append(np.asarray(entries.hidden)[place, rendering])
        model = self._model(
            np.concatenate(codes, axis=-1)[:, :, None],
            np.concatenate(scales)[:, None],
            np.concatenate(hidden)[:, None],
            np.zeros(1),
        )
        search = model.search_values(self._signature.values, self._signature.view)
        blocks = np.split(np.arange(len(model)), range(_EXACT_ONCE, len(model), _EXACT_ONCE))
        return np.concatenate([search.exact(rows)[0][:, 0] for rows in blocks])

    def _of_all(self, candidates: _Candidates) -> FloatArray:
        """Compare all renderings of some places as a map does, and their images, `(n,)`."""
        of_parts = [
            (entries, candidates.place[candidates.of_part(number)])
            for number, entries in enumerate(self._parts)
        ]
        codes = np.concatenate([np.asarray(one.codes)[..., some] for one, some in of_parts], -1)
        scales = np.concatenate([np.asarray(one.scales)[some] for one, some in of_parts])
        hidden = np.concatenate([np.asarray(one.hidden)[some] for one, some in of_parts])
        images = np.concatenate([np.asarray(one.images)[some] for one, some in of_parts])
        offset_m = np.asarray(self._parameters.lateral_renderings_m or (0.0,))
        offset_m = offset_m[beside(offset_m)]
        rows = np.arange(len(candidates))
        if self._image is not None and images.any(axis=(1, 2)).all():
            model = self._model(codes, scales, hidden, offset_m, images)
            return model.search_image(self._image, self._basis).distances_of(rows)
        model = self._model(codes, scales, hidden, offset_m)
        search = model.search_values(self._signature.values, self._signature.view)
        return search.distances_of(rows)

    def _model(
        self,
        codes: Int8Array,
        scales: Float32Array,
        hidden: IntArray,
        offset_m: FloatArray,
        images: NDArray[np.uint8] | None = None,
    ) -> HarmonicModel:
        """Return a map of some places."""
        grid = self._parameters.grid
        return HarmonicModel(
            self._basis.radial_basis,
            SignatureCodes(codes, scales),
            offset_m,
            np.array([0, len(hidden)]),
            grid.columns,
            Distance.NORMALISED,
            self._parameters.ranks,
            None if self._parameters.views == Views.FULL else hidden,
            images,
            grid.ring_m if isinstance(grid, RingGrid) else 1.0,
        )


def _nearest_ranks(parameters: "MapParameters", query: Complex64Array) -> int:
    """Return which of `compared_ranks` is nearest to those of a query."""
    r1, m = query.shape
    apart = [abs(r1 - one) + abs(m - other) for one, other in compared_ranks(parameters)]
    return int(np.argmin(apart))


def _all_numbers(basis: HarmonicBasis, image: Image) -> Signature:
    """Return an image's signature of as many numbers as maps keep."""
    (signature,) = basis.encode(image, basis.kept_ranks)
    return signature


def most(values: NDArray[Any], count: int) -> IntArray:
    """Return which values are the largest, in no order."""
    if len(values) <= count:
        return np.arange(len(values))
    some = np.arange(len(values))
    sample = values[:: max(1, len(values) // _SAMPLED)]
    few = int(1.5 * count * len(sample) / len(values)) + 1
    if few < len(sample):  # most values are less than any that is wanted
        least = np.partition(sample, len(sample) - few)[len(sample) - few]
        likely = np.flatnonzero(values >= least)
        some = likely if len(likely) >= count else some
    among = values[some]
    return some[np.argpartition(among, len(among) - count)[len(among) - count :]]


def _places(spans: IntArray, rows: IntArray) -> IntArray:
    """Return the places of rows of some ranges one after another."""
    lengths = spans[:, 1] - spans[:, 0]
    before = np.cumsum(lengths) - lengths
    of_span = np.searchsorted(before + lengths, rows, side="right")
    return np.asarray(rows - before[of_span] + spans[of_span, 0])
