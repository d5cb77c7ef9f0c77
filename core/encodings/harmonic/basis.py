"""The one basis of a harmonic map; the azimuth factor is a formula."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from core.arrays import Complex64Array, Float32Array, FloatArray, freeze
from core.encodings.basis import Basis, BasisFit, signature_parameters
from core.encodings.grams import fit_radial_basis, radial_error
from core.encodings.harmonics import encode, kept_ranks, least_ranks, sent_ranks
from core.encodings.signature import Signature
from core.errors import InvalidMap
from core.projection.imager import Image, Views
from core.projection.visibility import View
from core.revision import content_digest

if TYPE_CHECKING:
    from core.parameters import MapParameters


def harmonic_basis_digest(parameters: "MapParameters", radial_basis: Float32Array) -> str:
    """Return the digest of a harmonic basis: equal ones encode every scan equally."""
    return content_digest({"radial_basis": radial_basis}, signature_parameters(parameters))


@dataclass(frozen=True, eq=False)
class HarmonicBasis(Basis):
    """The one basis of a revision in the harmonic encoding.

    Attributes:
        radial_basis: `(I, r1)` float32, r1 being what maps keep.
    """

    radial_basis: Float32Array

    def __post_init__(self) -> None:
        freeze(self, radial_basis=np.float32)
        wanted = (self.parameters.grid.rows, kept_ranks(self.parameters)[0])
        if self.radial_basis.shape != wanted:
            raise InvalidMap(f"radial_basis has shape {self.radial_basis.shape}, wanted {wanted}")
        own = harmonic_basis_digest(self.parameters, self.radial_basis)
        if self.digest != own:
            raise InvalidMap(f"the basis says it is {self.digest}, its content is {own}")

    @classmethod
    def of(
        cls, parameters: "MapParameters", radial_basis: Float32Array, revision: str = ""
    ) -> "HarmonicBasis":
        """Return the basis of this U, `(I, r1)`."""
        digest = harmonic_basis_digest(parameters, radial_basis)
        return cls(revision, digest, parameters, radial_basis)

    @property
    def least_ranks(self) -> tuple[int, int]:
        """`(r1, r2)`, of maps of any views fewer than those that are sent."""
        if self.parameters.views == Views.FULL:
            return self.kept_ranks
        return least_ranks(self.parameters.ranks)

    def fits(self, grams: Mapping[str, FloatArray]) -> tuple[BasisFit, ...]:
        """Compare this basis with one fitted to all of these drives, drive by drive."""
        refitted = fit_radial_basis(grams, self.radial_basis.shape[1])
        return tuple(
            BasisFit(name, radial_error(gram, self.radial_basis), radial_error(gram, refitted))
            for name, gram in grams.items()
        )

    def project(self, image: Image) -> Complex64Array:
        """Return U^T S F, `(r1, r2)`, S being 0 where its view does not show it."""
        return self._project(image, sent_ranks(self.parameters, self.view(image)))

    def _project(self, image: Image, ranks: tuple[int, int]) -> Complex64Array:
        self.require_grid(image)
        near, (r1, r2) = slice(self.view(image).rings), ranks
        return encode(image.seen[near], self.radial_basis[near, :r1], r2).astype(np.complex64)

    def view(self, image: Image) -> View:
        """Return what the image shows; a map of full views takes every ring as within reach."""
        if self.parameters.views == Views.ANY:
            return image.view
        return View(image.view.hidden)

    def encode(self, image: Image, ranks: tuple[int, int] | None = None) -> tuple[Signature, ...]:
        """Return the image's one signature, good for all segments."""
        if ranks is None:
            values = self.project(image)
        else:
            self.require_ranks(ranks)
            values = self._project(image, ranks)
        return (Signature(values, None, self.digest, view=self.view(image)),)
