"""Many maps' places in one index (docs/decisions/0035-where-among-all-maps.md)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from core.arrays import FloatArray, IntArray
from core.encodings.basis import Basis
from core.encodings.harmonic.basis import HarmonicBasis
from core.encodings.harmonic.indexed_places import (
    RENDERINGS,
    HarmonicPlaces,
    Int8Array,
    beside,
    joined,
)
from core.encodings.harmonic.model import HarmonicModel
from core.encodings.harmonic.place_search import PlaceSearch, compared_ranks
from core.encodings.harmonic.renderings import LEAST_SEEN
from core.encodings.harmonics import kept_ranks, weights
from core.encodings.model import Model
from core.encodings.place_index import PlaceIndex
from core.encodings.signature import Signature
from core.errors import InvalidMap
from core.projection.imager import Image
from core.projection.visibility import SECTORS

if TYPE_CHECKING:
    from core.parameters import MapParameters

_COUNTED_AT_ONCE = 1024  # places whose energies are computed


@dataclass(frozen=True, eq=False)
class HarmonicPlaceIndex(PlaceIndex[HarmonicPlaces]):
    """How the places of all maps of one basis are indexed and found.

    Attributes:
        basis: The maps' basis.
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
        """The parameters of one of the maps; what signatures depend on is the same in all."""
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
        return PlaceSearch(self.basis, query, searched).nearest()
