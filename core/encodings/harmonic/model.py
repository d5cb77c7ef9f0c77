"""The model of a map in the harmonic encoding.

Relative yaw rotates the columns of an image, which does not change S S^T, nor U, and multiplies
harmonic m by a phase. So a signature of any heading is compared with the map's in every heading,
and the best one is the relative yaw.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from core.arrays import (
    BoolArray,
    Complex64Array,
    Float32Array,
    FloatArray,
    IntArray,
    arrays_of,
    freeze,
)
from core.encodings.basis import Basis
from core.encodings.distance import Distance
from core.encodings.harmonic.basis import HarmonicBasis, harmonic_basis_digest
from core.encodings.harmonic.codes import SignatureCodes
from core.encodings.harmonic.masked_search import MaskedSearch
from core.encodings.harmonic.own_search import own_search
from core.encodings.harmonic.query_limits import limited, limits_of, limits_of_scan
from core.encodings.harmonic.renderings import ESTIMATED_WAVES, Renderings, renderings_of
from core.encodings.harmonic.search import HarmonicSearch
from core.encodings.harmonic.seen import Seen
from core.encodings.harmonic.stored import StoredSignatures
from core.encodings.harmonic.verified_search import VerifiedSearch
from core.encodings.harmonics import encode, least_ranks, narrow_ranks, sent_ranks
from core.encodings.model import Model, require_sane
from core.encodings.search import QueryLimits, Search
from core.encodings.signature import Signature
from core.errors import InvalidMap, InvalidSignature
from core.projection.imager import Image
from core.projection.small_image import DisplacedView
from core.projection.visibility import FULL_VIEW, SECTORS, View, seen_of_bits
from core.single_flight import SingleFlight, single_flight_property, weakly

if TYPE_CHECKING:
    from core.parameters import MapParameters

_ACROSS = 5  # places from which a small image is compared
_BEYOND_M = 1.5  # the outermost viewpoints: such images need not be kept
_LIMITED_KEPT = 4  # models of fewer radial components: of a small map each is a decoded copy
_LIMITED_RENDERINGS = 400_000  # in all models within some rings; each 28 to 252 bytes


@dataclass(frozen=True, eq=False)
class HarmonicModel(Model):
    """All scans' signatures in one basis, each from several places beside the line.

    Attributes:
        radial_basis: `(I, r1)` float32, orthonormal columns; U of all segments.
        stored: Signatures of D renderings of each scan, as codes or, from a file of an older
            version, as numbers.
        lateral_offset_m: `(D,)` of the viewpoint of each rendering.
        segment_start: `(L + 1,)` row of each segment's first scan, and K.
        columns: J, how many azimuths an image has.
        measure: How signatures are compared.
        sent_ranks: `(r1, r2)` of a query of the whole image, up to those of `signatures`.
        hidden_sectors: `(K, D)` of a map of any views: bit s of each number is 1 if the rendering
            does not see sector s; `None` of a map of full views.
        verification_images: `(K, I, 60)` uint8, `small_image` of each scan from its line; `None`
            of a map without them.
        ring_m: How wide a ring of them is; of a map without them it is not used.
    """

    encoding: ClassVar[str] = "harmonic"

    radial_basis: Float32Array
    stored: StoredSignatures
    lateral_offset_m: FloatArray
    segment_start: IntArray
    columns: int
    measure: Distance
    sent_ranks: tuple[int, int]
    hidden_sectors: IntArray | None = None
    verification_images: NDArray[np.uint8] | None = None
    ring_m: float = 1.0

    def __post_init__(self) -> None:
        freeze(self, radial_basis=np.float32)
        freeze(self, lateral_offset_m=np.float64, segment_start=np.int64)
        if self.radial_basis.ndim != 2:
            raise InvalidMap("the radial basis has two axes")
        scans, renderings, r1, r2 = self.stored.shape
        if self.radial_basis.shape[1] != r1 or self.lateral_offset_m.shape != (renderings,):
            raise InvalidMap(
                f"radial_basis {self.radial_basis.shape}, signatures {self.stored.shape} and"
                f" lateral_offset_m {self.lateral_offset_m.shape} do not fit together"
            )
        if not 1 <= r2 <= self.columns // 2 + 1 or r1 < 1:
            raise InvalidMap(f"signatures have {r2} harmonics of {self.columns} columns")
        self._require_rising(scans)
        require_sane(self.bases, np.empty(0, np.complex64))
        if not np.isfinite(self.lateral_offset_m).all():
            raise InvalidMap("lateral_offset_m has numbers that are not finite")
        if self.hidden_sectors is not None:
            freeze(self, hidden_sectors=np.int64)
            if self.hidden_sectors.shape != (scans, renderings):
                raise InvalidMap(
                    f"hidden_sectors has shape {self.hidden_sectors.shape}, wanted"
                    f" {(scans, renderings)}"
                )
            if (self.hidden_sectors >> SECTORS).any():  # a negative number has bits beyond too
                raise InvalidMap(f"hidden_sectors has bits of others than {SECTORS} sectors")
        self._require_images(scans)

    def __repr__(self) -> str:  # without the arrays
        scans, segments, ranks = len(self), self.segments, self.ranks
        renderings, grid_shape = len(self.lateral_offset_m), self.grid_shape
        return f"HarmonicModel({scans=}, {segments=}, {renderings=}, {ranks=}, {grid_shape=})"

    def _require_images(self, scans: int) -> None:
        if self.verification_images is None:
            return
        wanted = (scans, self.grid_shape[0], SECTORS)
        images = np.asarray(self.verification_images)
        if self.hidden_sectors is None or images.shape != wanted:
            raise InvalidMap(
                f"verification_images has shape {images.shape}, wanted {wanted} of any views"
            )
        if images.dtype != np.uint8:
            raise InvalidMap(f"verification_images holds {images.dtype}, wanted uint8")
        freeze(self, verification_images=np.uint8)

    @property
    def bases(self) -> dict[str, NDArray[Any]]:
        """The radial basis, of all segments."""
        return {"radial_basis": self.radial_basis}

    @property
    def ranks(self) -> tuple[int, int]:
        """`(r1, r2)`, the shape of a signature."""
        return self.stored.shape[2:]

    @property
    def signatures(self) -> Complex64Array:
        """All signatures as numbers, `(K, D, r1, r2)`; of a large map decoded each time."""
        return self.renderings.numbers

    @single_flight_property
    def renderings(self) -> Renderings:
        """The signatures as searches compare them."""
        return renderings_of(self.stored, self.columns)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return every array by its name in the file."""
        return {**arrays_of(self), **self.stored.arrays()}

    @property
    def grid_shape(self) -> tuple[int, int]:
        """`(I, J)`, the shape of an image."""
        return self.radial_basis.shape[0], self.columns

    def search(self, signatures: Sequence[Signature]) -> HarmonicSearch:
        """Compare one scan's signature with the map's in every heading.

        Raises:
            InvalidSignature: If it is of another encoding, has too few numbers to tell places
                apart, or there are several.
        """
        if len(signatures) != 1 or signatures[0].encoding != self.encoding:
            raise InvalidSignature(
                "a harmonic map expects exactly one harmonic signature, without a segment"
            )
        values, view = signatures[0].values, signatures[0].view
        self.limits_of(values.shape, view)  # refuses too few numbers
        return self.search_values(values, view)

    def limits_of(self, shape: tuple[int, ...], view: View) -> QueryLimits | None:
        """Return what a signature is limited to that has or sees less than the map's queries.

        Raises:
            InvalidSignature: If it has too few numbers to tell places apart.
        """
        limits = self._limits_of(shape, view)
        if limits is not None:
            _require_enough(shape, self.sent_ranks)
        return limits

    def _limits_of(self, shape: tuple[int, ...], view: View) -> QueryLimits | None:
        if self.hidden_sectors is None:
            return None
        usual = self.sent_ranks
        if view.is_narrow:
            usual = narrow_ranks(usual, self.ranks[0])
        return limits_of(shape, usual, view, self.grid_shape[0])

    def limited_query(
        self, row: int, named: str, limits: QueryLimits, turned: int
    ) -> Signature | None:
        """Return what a scan's recorded signature would be within limits."""
        rows, on_line = np.array([row]), np.array([[self.on_line]])
        within = self.seen_within(limits.view.rings, limits.ranks[0])
        recorded = within.renderings.at(rows, on_line)[0, 0]
        own = np.flatnonzero(~self.seen_on_line(rows)[0]).tolist()
        return limited(recorded, own, limits, turned, self.columns, named)

    def search_values(self, values: NDArray[Any], view: View = FULL_VIEW) -> HarmonicSearch:
        """Compare an image's values, `(r1, r2)`; in a map of any views fewer than kept as well.

        Raises:
            InvalidSignature: If the view is partial, and this is a map of full views.
        """
        query = values.astype(np.complex128)
        if self.hidden_sectors is not None:
            search = MaskedSearch(self.seen_within(view.rings, len(values)), query, view)
            search.limits = self._limits_of(values.shape, view)
            return search
        if not view.is_full:
            raise InvalidSignature(
                f"the signature is of a partial view ({len(view.hidden)} sectors are hidden); this"
                " map answers full views only, one built with views = any answers partial ones"
            )
        return HarmonicSearch(self, query)

    def search_image(self, image: Image, basis: Basis) -> Search:
        """Compare an image with the map's: with all kept harmonics, and the best cell by cell.

        More radial components than are sent would find fewer vehicles beside the viewpoints. In a
        map without verification images an image is compared as its signature.

        Raises:
            SensorMismatch: If the image is of another kind or on another grid.
        """
        if self.verification_images is None:
            return super().search_image(image, basis)
        basis.require_grid(image)
        view = image.view
        r1, r2 = sent_ranks(basis.parameters, view)
        near = slice(view.rings)
        values = encode(image.seen[near], self.radial_basis[near, :r1], self.ranks[1])
        model = self.seen_within(view.rings, r1)
        search = VerifiedSearch(
            model, values, view, image.cells, lambda: self.search_values(values[:, :r2], view)
        )
        search.limits = limits_of_scan((r1, self.ranks[1]), view, self.grid_shape[0])
        return search

    def small_images(self, rows: IntArray) -> NDArray[np.uint8]:
        """Return the verification images of some scans, `(n, I, 60)`."""
        assert self.verification_images is not None  # noqa: S101 - for mypy
        return self.verification_images[rows]

    def seen_on_line(self, rows: IntArray) -> BoolArray:
        """Return the sectors that some scans see from their line, `(n, 60)`."""
        assert self.hidden_sectors is not None  # noqa: S101 - for mypy
        return seen_of_bits(self.hidden_sectors[rows, self.on_line], SECTORS)

    @single_flight_property
    def beside(self) -> DisplacedView:
        """From a small image on the line to those across it, beyond the viewpoints too."""
        first, last = (self.lateral_offset_m[[0, -1]] - self.recorded_lateral_m).tolist()
        left_m = np.linspace(first - _BEYOND_M, last + _BEYOND_M, _ACROSS)
        grid = self.grid_shape[0], self.ring_m, self.columns
        return DisplacedView.at(*grid, np.zeros_like(left_m), left_m)

    def seen_within(self, rings: int | None, r1: int) -> "HarmonicModel":
        """Return what queries of so many radial components can see of this within so many rings.

        Of a rendering S, of which U^T S is known, such a query would contain U^T P S, P leaving
        those rings. U^T P U (U^T S) is that, but for what U leaves out of S.
        """
        if rings is not None:
            return self._within(rings, r1)
        return self if r1 == self.ranks[0] else self._of_components(r1)

    @single_flight_property
    def _of_components(self) -> "SingleFlight[HarmonicModel]":
        return SingleFlight(weakly(self._first_components), _LIMITED_KEPT)

    def _first_components(self, r1: int) -> "HarmonicModel":
        return self._limited(r1, self.stored.limited(r1))

    @single_flight_property
    def _within(self) -> "SingleFlight[HarmonicModel]":
        """Models within some rings, of which codes are not copied: norms and energies are kept.

        A sensor of short range needs one of each number of rings, scan by scan.
        """
        kept = _LIMITED_KEPT
        if isinstance(self.stored, SignatureCodes):
            kept = max(kept, _LIMITED_RENDERINGS // max(self.stored.scales.size, 1))
        return SingleFlight(weakly(self._mixed), kept)

    def _mixed(self, rings: int, r1: int) -> "HarmonicModel":
        near = self.radial_basis[:rings]
        return self._limited(r1, self.stored.mixed((near.T @ near)[:r1]))

    def _limited(self, r1: int, stored: StoredSignatures) -> "HarmonicModel":
        limited = replace(self, radial_basis=self.radial_basis[:, :r1], stored=stored)
        if self.hidden_sectors is not None:
            vars(limited)["seen"] = self.seen  # the same, in the same memory
        if self.verification_images is not None:
            vars(limited)["beside"] = self.beside
        return limited

    @property
    def recorded(self) -> Complex64Array:
        """Signatures from the viewpoint nearest to the recorded line, `(K, r1, r2)`."""
        rows = np.arange(len(self))
        return self.renderings.at(rows, np.array([[self.on_line]]))[:, 0]

    @property
    def recorded_lateral_m(self) -> float:
        """How far to the left of the recorded line that viewpoint is."""
        return float(self.lateral_offset_m[self.on_line])

    @property
    def on_line(self) -> int:
        """Which rendering is from the viewpoint nearest to the recorded line."""
        return int(np.abs(self.lateral_offset_m).argmin())

    @property
    def gives_relative_yaw(self) -> bool:
        """Whether there is a harmonic that relative yaw changes."""
        return self.ranks[1] > 1

    def own_queries(
        self, rows: Iterable[int], named: str, segments: IntArray | None = None
    ) -> Iterator[tuple[Signature, ...]]:
        """Yield each scan's recorded signature: one for all segments."""
        (r1, r2), on_line = self.sent_ranks, np.array([[self.on_line]])
        for row in rows:
            recorded = self.renderings.at(np.array([row]), on_line)[0, 0]
            view = FULL_VIEW
            if self.hidden_sectors is not None:
                view = View.of_bits(int(self.hidden_sectors[row, self.on_line]))
            yield (Signature(recorded[:r1, :r2], None, named, view=view),)

    def search_own(
        self, row: int, limits: QueryLimits | None = None, turned: int = 0
    ) -> VerifiedSearch | None:
        """Return the search of a query at one of its scans, by the small image that it keeps of it.

        `None` without one, or if nothing is in what is left of it.
        """
        return own_search(self, row, limits, turned)

    def basis_digests(self, parameters: "MapParameters") -> tuple[str, ...]:
        """Return the digest of the one basis."""
        return (harmonic_basis_digest(parameters, self.radial_basis),)

    def basis(
        self, revision: str, digest: str, parameters: "MapParameters", segments: IntArray
    ) -> HarmonicBasis:
        """Return the one basis."""
        return HarmonicBasis(revision, digest, parameters, self.radial_basis)

    def select(
        self, rows: IntArray, segments: IntArray, segment_start: IntArray
    ) -> "HarmonicModel":
        """Return the model of some scans, unchanged."""
        hidden, images = self.hidden_sectors, self.verification_images
        return replace(
            self,
            stored=self.stored.select(rows),
            segment_start=segment_start,
            hidden_sectors=None if hidden is None else hidden[rows],
            verification_images=None if images is None else images[rows],
        )

    def joined(self, others: Sequence["HarmonicModel"], segment_start: IntArray) -> "HarmonicModel":
        """Return one model of this one's scans and those of others of the same basis."""
        models = (self, *others)
        hidden = [m.hidden_sectors for m in models if m.hidden_sectors is not None]
        images = [m.verification_images for m in models if m.verification_images is not None]
        return replace(
            self,
            stored=self.stored.joined([m.stored for m in others]),
            segment_start=segment_start,
            hidden_sectors=np.concatenate(hidden) if hidden else None,
            verification_images=np.concatenate(images) if images else None,
        )

    @single_flight_property
    def seen(self) -> Seen:
        """What the renderings of a map of any views see."""
        hidden, r2 = np.asarray(self.hidden_sectors), self.ranks[1]
        each = not self.renderings.is_large
        return Seen(hidden, self.columns, r2, ESTIMATED_WAVES, each=each)


def _require_enough(ranks: tuple[int, ...], usual: tuple[int, int]) -> None:
    least = least_ranks(usual)
    if ranks[0] < least[0] or ranks[1] < least[1]:
        raise InvalidSignature(
            f"the signature has {ranks[0]} x {ranks[1]} numbers, too few to tell places apart;"
            f" wanted {usual[0]} x {usual[1]}, or at least {least[0]} x {least[1]}"
        )
