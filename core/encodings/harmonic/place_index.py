"""Many maps' places in one index: the few hundred that a query may be of, then compared exactly."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from core.arrays import Float32Array, FloatArray, IntArray, arrays_of
from core.encodings.basis import Basis
from core.encodings.distance import Distance
from core.encodings.harmonic.model import HarmonicModel
from core.encodings.harmonic.numbers import SignatureNumbers
from core.encodings.harmonic.place_code import RENDERINGS, Int8Array, PlaceCode, beside
from core.encodings.harmonics import two_sided, weights
from core.encodings.model import Model
from core.encodings.place_index import PlaceEntries, PlaceIndex
from core.encodings.signature import Signature
from core.errors import InvalidMap
from core.projection.imager import Views
from core.projection.visibility import sector_of_column

if TYPE_CHECKING:
    from core.parameters import MapParameters

_OF_LISTS = {"members", "list_start"}
_FEW_HIDDEN = 6  # sectors: with more a code says less
_VISITED, _VISITED_PARTIAL = 48, 192  # lists
_CHOSEN, _CHOSEN_PARTIAL = 2000, 6000  # places whose signatures are compared
_EXACT, _EXACT_PARTIAL = 192, 640  # of which so many are compared as in a map
_HEADINGS = 48
_FEW_PLACES = 10_000  # of which all codes are compared
_BLOCK = 8192  # codes, in the processor's cache
_PLACES = 512  # likewise, with their signatures
_LEAST_NORM = np.float32(1e-6)


@dataclass(frozen=True, eq=False)
class HarmonicPlaces(PlaceEntries):
    """The places of some maps, map after map.

    Attributes:
        codes: `(n, 5, v)` int8, of five renderings.
        members: `(5 n,)` int32, the renderings of each list, list after list.
        list_start: `(c + 1,)` where each list begins in `members`.
        signatures: `(n, 5, r1, 2 r2 - 1)` int8, signed roots of real and imaginary parts.
        scales: `(n, 5)` float32 of these.
        hidden: `(n, 5)` int64, the sectors that each does not see.
    """

    codes: Int8Array
    members: NDArray[np.int32]
    list_start: IntArray
    signatures: Int8Array
    scales: Float32Array
    hidden: IntArray

    def __len__(self) -> int:
        return len(self.codes)

    @classmethod
    def of(cls, arrays: Mapping[str, NDArray[Any]]) -> "HarmonicPlaces":
        """Return the entries of these `arrays`, checked."""
        entries = cls(**arrays)
        found = [len(array) for name, array in arrays.items() if name not in _OF_LISTS]
        if len(set(found)) != 1 or len(entries.members) != RENDERINGS * len(entries):
            raise InvalidMap(f"the entries of an index are {found} places")
        return entries

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return every array by its name."""
        return {name: np.asarray(array) for name, array in arrays_of(self).items()}

    def of_places(self, places: IntArray) -> dict[str, NDArray[Any]]:
        """Return the arrays of some places, without their lists."""
        arrays = self.arrays()
        return {name: arrays[name][places] for name in ("codes", "signatures", "scales", "hidden")}

    @cached_property
    def renderings(self) -> Int8Array:
        """All codes, `(5 n, v)`."""
        return self.codes.reshape(-1, self.codes.shape[-1])


@dataclass(frozen=True, eq=False)
class HarmonicPlaceIndex(PlaceIndex[HarmonicPlaces]):
    """How the places of all maps of one basis are indexed and found.

    Attributes:
        code: Of all of them.
        radial_basis: U, `(I, r1)`.
        parameters: Of one of the maps; what signatures depend on is the same in all.
    """

    code: PlaceCode
    radial_basis: Float32Array
    parameters: "MapParameters"

    @classmethod
    def train(cls, basis: Basis, models: Sequence[Model], places: int) -> "HarmonicPlaceIndex":
        """Return an index whose code is trained with some maps."""
        code = PlaceCode.train([one for one in models if isinstance(one, HarmonicModel)], places)
        return cls.of(basis, code.arrays())

    @classmethod
    def of(cls, basis: Basis, arrays: Mapping[str, NDArray[Any]]) -> "HarmonicPlaceIndex":
        """Return the index of these `arrays`."""
        return cls(PlaceCode(**arrays), basis.arrays()["radial_basis"], basis.parameters)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return what is stored of the index besides its entries, by name."""
        return self.code.arrays()

    def entries(self, models: Sequence[Model]) -> HarmonicPlaces:
        """Return the entries of all scans of some maps."""
        parts = [self._of_model(one) for one in models if isinstance(one, HarmonicModel)]
        return self.listed({name: np.concatenate([p[name] for p in parts]) for name in parts[0]})

    def read(self, arrays: Mapping[str, NDArray[Any]]) -> HarmonicPlaces:
        """Return stored entries of these `arrays`."""
        return HarmonicPlaces.of(arrays)

    def listed(self, arrays: Mapping[str, NDArray[Any]]) -> HarmonicPlaces:
        """Return entries with these arrays, and lists that are made of them."""
        codes = arrays["codes"]
        lists = self.code.lists_of(codes.reshape(-1, codes.shape[-1]))
        counts = np.bincount(lists, minlength=len(self.code.centres))
        return HarmonicPlaces(
            members=np.argsort(lists, kind="stable").astype(np.int32),
            list_start=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
            **arrays,
        )

    def _of_model(self, model: HarmonicModel) -> dict[str, NDArray[Any]]:
        chosen = beside(model, model.stored.numbers)  # `signatures` would be kept with the model
        numbers = np.concatenate([chosen.real, chosen.imag[..., 1:]], axis=-1)
        scales = np.abs(numbers).max(axis=(-2, -1)) / 127.0**2
        safe = np.where(scales > 0, scales, 1.0)[..., None, None]
        hidden = np.zeros(chosen.shape[:2], np.int64)
        if model.hidden_sectors is not None:
            hidden = beside(model, model.hidden_sectors)
        return {
            "codes": self.code.of(chosen),
            "signatures": np.copysign(np.rint(np.sqrt(np.abs(numbers) / safe)), numbers).astype(
                np.int8
            ),
            "scales": scales.astype(np.float32),
            "hidden": hidden,
        }

    def candidates(
        self, entries: HarmonicPlaces, signature: Signature, places: IntArray | None = None
    ) -> tuple[IntArray, Float32Array]:
        """Compare the codes of a few places, or of the lists nearest to the query's code."""
        query, chosen = self.code.of_query(signature.values), self._chosen(signature)
        count = len(entries) if places is None else len(places)
        if count <= _FEW_PLACES:
            some = np.arange(count) if places is None else places
            far = _far(entries.codes[some].reshape(-1, len(query)), query)
            far = far.reshape(-1, RENDERINGS).min(axis=1)
        else:
            some, far = self._in_lists(entries, signature, query, places)
        nearest = _least(far, chosen)
        return some[nearest], far[nearest]

    def _in_lists(
        self,
        entries: HarmonicPlaces,
        signature: Signature,
        query: Float32Array,
        places: IntArray | None,
    ) -> tuple[IntArray, Float32Array]:
        visited = _VISITED_PARTIAL if _is_partial(signature) else _VISITED
        start = entries.list_start
        lists = _least(_far(self.code.centres, query), visited)
        members = np.concatenate([entries.members[start[n] : start[n + 1]] for n in lists])
        if places is not None:
            allowed = np.zeros(len(entries), bool)
            allowed[places] = True
            members = members[allowed[members // RENDERINGS]]
        members.sort()  # in the order of the file
        far = _far(entries.renderings, query, members)
        of_place = members // RENDERINGS
        first = np.flatnonzero(np.diff(of_place, prepend=-1))
        if not len(first):
            return np.empty(0, np.int64), far
        return of_place[first].astype(np.int64), np.minimum.reduceat(far, first)

    @staticmethod
    def _chosen(signature: Signature) -> int:
        return _CHOSEN_PARTIAL if _is_partial(signature) else _CHOSEN

    def most_alike(
        self, signature: Signature, found: Sequence[tuple[HarmonicPlaces, IntArray, Float32Array]]
    ) -> list[tuple[IntArray, FloatArray]]:
        """Compare the candidates whose signatures are most alike as a map compares them."""
        far = np.concatenate([one for _, _, one in found])
        part = np.repeat(np.arange(len(found)), [len(one) for _, _, one in found])
        place = np.concatenate([one for _, one, _ in found])
        kept = _least(far, self._chosen(signature))
        kept = kept[np.lexsort((place[kept], part[kept]))]  # in the order of the files
        part, place = part[kept], place[kept]
        parts = [
            entries.of_places(place[part == number]) for number, (entries, _, _) in enumerate(found)
        ]
        arrays = {
            name: np.concatenate([one[name] for one in parts])
            for name in ("signatures", "scales", "hidden")
        }
        exact = _EXACT_PARTIAL if _is_partial(signature) else _EXACT
        nearest = np.sort(_least(-self._likeness(signature, arrays), exact))
        model = self._model({name: array[nearest] for name, array in arrays.items()})
        distances = model.search_values(signature.values, signature.view).distances()
        part, place = part[nearest], place[nearest]
        return [(place[part == number], distances[part == number]) for number in range(len(found))]

    def _likeness(self, signature: Signature, arrays: Mapping[str, NDArray[Any]]) -> Float32Array:
        """Return the best correlation of places with a query over headings, estimated, `(n,)`.

        Of a partial view the norm of what it would have seen is taken as that of the whole.
        """
        columns, values = self.parameters.grid.columns, signature.values.astype(np.complex128)
        harmonics = (arrays["signatures"].shape[-1] + 1) // 2
        sent = values.shape[1]
        query = values
        if signature.view.hidden:
            seen = ~np.isin(sector_of_column(columns), signature.view.hidden)
            mask = np.fft.fft(seen) / columns
            sent_harmonics = np.arange(1 - sent, sent)
            mixed = mask[(sent_harmonics[:, None] - np.arange(1 - harmonics, harmonics)) % columns]
            query = (two_sided(values) @ mixed.conj())[:, harmonics - 1 :]
        count = query.shape[1]
        turns = np.exp(2j * np.pi / _HEADINGS * np.outer(np.arange(_HEADINGS), np.arange(count)))
        turned = (query * turns[:, None] * weights(columns, count)).astype(np.complex64)
        kept = [*range(count), *range(harmonics, harmonics + count - 1)]
        products = np.concatenate([turned.real, turned.imag[..., 1:]], axis=-1)
        products = products.reshape(_HEADINGS, -1).T
        counted = weights(columns, count)
        counted = np.concatenate([counted, counted[1:]]).astype(np.float32)
        best = np.empty(len(arrays["signatures"]), np.float32)
        for start in range(0, len(best), _PLACES):
            block = slice(start, start + _PLACES)
            roots = arrays["signatures"][block, :, : len(values)][..., kept].astype(np.float32)
            numbers = roots * np.abs(roots)
            norm = np.sqrt((np.square(numbers) @ counted).sum(axis=-1))
            score = numbers.reshape(-1, products.shape[0]) @ products
            score = score.max(axis=1).reshape(norm.shape) / np.maximum(norm, _LEAST_NORM)
            best[block] = score.max(axis=1)
        return best

    def _model(self, arrays: Mapping[str, NDArray[Any]]) -> HarmonicModel:
        """Return a map of some places; from where their renderings are is not known."""
        roots = arrays["signatures"].astype(np.float32)
        numbers = roots * np.abs(roots) * arrays["scales"][..., None, None]
        harmonics = (numbers.shape[-1] + 1) // 2
        signatures = numbers[..., :harmonics].astype(np.complex64)
        signatures.imag[..., 1:] = numbers[..., harmonics:]
        return HarmonicModel(
            self.radial_basis,
            SignatureNumbers(signatures),
            np.arange(RENDERINGS, dtype=np.float64),
            np.array([0, len(signatures)]),
            self.parameters.grid.columns,
            Distance.NORMALISED,
            self.parameters.ranks,
            None if self.parameters.views == Views.FULL else arrays["hidden"],
        )


def _is_partial(signature: Signature) -> bool:
    view = signature.view
    return len(view.hidden) > _FEW_HIDDEN or view.rings is not None


def _far(
    codes: NDArray[Any], query: Float32Array, rows: NDArray[np.int32] | None = None
) -> Float32Array:
    """Return the squared distances of `(n, v)` codes, or of some rows of them."""
    count = len(codes) if rows is None else len(rows)
    far = np.empty(count, np.float32)
    for start in range(0, count, _BLOCK):
        block = slice(start, start + _BLOCK)
        off = np.subtract(codes[block if rows is None else rows[block]], query, dtype=np.float32)
        far[block] = np.einsum("nv,nv->n", off, off)
    return far


def _least(values: NDArray[Any], count: int) -> IntArray:
    """Return which values are the least, in no order."""
    if len(values) <= count:
        return np.arange(len(values))
    return np.argpartition(values, count)[:count]
