"""The bases of segments, and a scan's signature in each, U^T S V (paper, sec. 2.3, eq. 2)."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from core.arrays import Float32Array, IntArray, freeze
from core.encodings.basis import Basis, signature_parameters
from core.encodings.signature import Signature
from core.errors import InvalidMap
from core.projection.imager import Image
from core.revision import content_digest

if TYPE_CHECKING:
    from core.parameters import MapParameters


def paper_basis_digests(
    parameters: "MapParameters", elevation_basis: Float32Array, azimuth_basis: Float32Array
) -> tuple[str, ...]:
    """Return the digests of the bases of the first 1, 2, ... L segments.

    Each is computed from the one before and one segment more. So bases of a map's first segments
    are a part of every map that continues with others: adding a drive at the end does not change
    their digest.

    Args:
        parameters: The map's parameters.
        elevation_basis: `(L, I, r1)`.
        azimuth_basis: `(L, J, r2)`.
    """
    digests: list[str] = []
    for u, v in zip(elevation_basis, azimuth_basis, strict=True):
        before = {"before": digests[-1]} if digests else signature_parameters(parameters)
        digests.append(content_digest({"elevation_basis": u, "azimuth_basis": v}, before))
    return tuple(digests)


@dataclass(frozen=True, eq=False)
class PaperBasis(Basis):
    """The bases of some segments of one revision in the paper's encoding.

    Its digest is that of the bases of all segments of the revision.

    Attributes:
        segments: `(S,)` which segments these are.
        elevation_basis: `(S, I, r1)` float32.
        azimuth_basis: `(S, J, r2)` float32.
    """

    segments: IntArray
    elevation_basis: Float32Array
    azimuth_basis: Float32Array

    def __post_init__(self) -> None:
        freeze(self, segments=np.int64, elevation_basis=np.float32, azimuth_basis=np.float32)
        sizes = zip(self.parameters.grid.shape, self.parameters.ranks, strict=True)
        for name, size in zip(("elevation_basis", "azimuth_basis"), sizes, strict=True):
            shape, wanted = getattr(self, name).shape, (len(self.segments), *size)
            if shape != wanted:
                raise InvalidMap(f"{name} has shape {shape}, wanted {wanted}")

    def as_values(self) -> dict[str, Any]:
        """Return the bases segment by segment, as plain values; a float32 survives it."""
        return {
            "segments": [
                {"segment": segment, "elevation_basis": u.tolist(), "azimuth_basis": v.tolist()}
                for segment, u, v in zip(
                    self.segments.tolist(), self.elevation_basis, self.azimuth_basis, strict=True
                )
            ]
        }

    def project(self, image: Image) -> Float32Array:
        """Return U^T S V in each segment's bases, `(S, r1, r2)`."""
        self.require_grid(image)
        values = (
            self.elevation_basis.transpose(0, 2, 1)
            @ image.cells.astype(np.float64)
            @ self.azimuth_basis
        )
        return np.asarray(values, np.float32)

    def encode(self, image: Image, ranks: tuple[int, int] | None = None) -> tuple[Signature, ...]:
        """Return the image's signature in each segment's bases."""
        self.require_ranks(ranks or self.kept_ranks)
        return tuple(
            Signature(values, segment, self.digest)
            for values, segment in zip(self.project(image), self.segments.tolist(), strict=True)
        )
