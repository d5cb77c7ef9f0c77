"""What a vehicle downloads once to make signatures on board."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.arrays import Float32Array, IntArray, frozen
from core.encodings.harmonic import encode
from core.encodings.signature import Signature
from core.errors import InvalidMap, SensorMismatch
from core.parameters import MapParameters
from core.projection.height_image import HeightImage
from core.projection.imager import Image, ImageKind
from core.revision import content_digest
from core.scans.scan import Scan

__all__ = [
    "Basis",
    "HarmonicBasis",
    "PaperBasis",
    "harmonic_basis_digest",
    "make_same_signatures",
    "paper_basis_digests",
]

_OF_SIGNATURES = (
    "encoding",
    "image",
    "ranks",
    "reducer",
    "sensor",
    "grid",
    "sensor_height_m",
)
"""The parameters that a signature depends on; how signatures are compared is none of them."""


def harmonic_basis_digest(parameters: MapParameters, radial_basis: Float32Array) -> str:
    """Return what names a harmonic basis: equal ones make equal signatures of every scan."""
    return content_digest({"radial_basis": radial_basis}, _of_signatures(parameters))


def make_same_signatures(one: MapParameters, other: MapParameters) -> bool:
    """Return whether maps of these parameters that share a basis encode every scan alike."""
    return _of_signatures(one) == _of_signatures(other)


def paper_basis_digests(
    parameters: MapParameters, elevation_basis: Float32Array, azimuth_basis: Float32Array
) -> tuple[str, ...]:
    """Return what names the bases of the first 1, 2, ... L segments, `L` digests.

    Each is made of the one before and one segment more. So who holds the bases of a map's first
    segments holds a part of every map that continues with others: adding a drive at the end leaves
    the digest of what was there as it was.

    Args:
        parameters: Of the map.
        elevation_basis: `(L, I, r1)`.
        azimuth_basis: `(L, J, r2)`.
    """
    digests: list[str] = []
    for u, v in zip(elevation_basis, azimuth_basis, strict=True):
        before = {"before": digests[-1]} if digests else _of_signatures(parameters)
        digests.append(content_digest({"elevation_basis": u, "azimuth_basis": v}, before))
    return tuple(digests)


def _of_signatures(parameters: MapParameters) -> dict[str, Any]:
    attributes = {**parameters.as_attributes(), "image": parameters.image.value}
    return {name: attributes[name] for name in _OF_SIGNATURES}


@dataclass(frozen=True, eq=False)
class Basis(ABC):
    """How one revision makes signatures of scans; no scan's place can be read from it.

    Attributes:
        revision: Digest of the map revision.
        digest: What names the basis, the same in every revision that has it; signatures made with
            it name it.
        parameters: How scans become images; grid, reducer and sensor.
    """

    revision: str
    digest: str
    parameters: MapParameters

    @abstractmethod
    def encode(self, image: Image) -> tuple[Signature, ...]:
        """Return the image's signatures (paper, sec. 2.3).

        Raises:
            SensorMismatch: If the image is of another kind or on another grid.
        """

    @abstractmethod
    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return every array by its name."""

    def image(self, scan: Scan, sensor_height_m: float | None = None) -> Image:
        """Project a scan as the map's own scans were.

        Args:
            scan: The returns.
            sensor_height_m: Of this scan's sensor, if it is mounted otherwise than the map's.

        Raises:
            InvalidScan: If no return falls inside the grid.
        """
        return self.parameters.imager.image(scan, sensor_height_m)

    def require_grid(self, image: Image) -> None:
        """Raise `SensorMismatch` unless the image is of this map's kind and on its grid."""
        kind = ImageKind.HEIGHT if isinstance(image, HeightImage) else ImageKind.RANGE
        if kind != self.parameters.image:
            raise SensorMismatch(
                f"the image is a {kind} image, the map is of {self.parameters.image} images"
            )
        if image.grid != self.parameters.grid:
            raise SensorMismatch(f"the image is on {image.grid}, the map on {self.parameters.grid}")


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
        object.__setattr__(self, "segments", frozen(self.segments, np.int64))
        object.__setattr__(self, "elevation_basis", frozen(self.elevation_basis, np.float32))
        object.__setattr__(self, "azimuth_basis", frozen(self.azimuth_basis, np.float32))
        (rows, columns), (r1, r2) = self.parameters.grid.shape, self.parameters.ranks
        count = len(self.segments)
        if self.elevation_basis.shape != (count, rows, r1):
            raise InvalidMap(f"elevation_basis has shape {self.elevation_basis.shape}")
        if self.azimuth_basis.shape != (count, columns, r2):
            raise InvalidMap(f"azimuth_basis has shape {self.azimuth_basis.shape}")

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return every array by its name."""
        return {
            "segments": self.segments,
            "elevation_basis": self.elevation_basis,
            "azimuth_basis": self.azimuth_basis,
        }

    def encode(self, image: Image) -> tuple[Signature, ...]:
        """Return the image's signature in each segment's bases."""
        self.require_grid(image)
        values = (
            self.elevation_basis.transpose(0, 2, 1)
            @ image.cells.astype(np.float64)
            @ self.azimuth_basis
        )
        return tuple(
            Signature(slice_.astype(np.float32), segment, self.digest)
            for slice_, segment in zip(values, self.segments.tolist(), strict=True)
        )


@dataclass(frozen=True, eq=False)
class HarmonicBasis(Basis):
    """The one basis of a revision in the harmonic encoding; the azimuth factor is a formula.

    Attributes:
        radial_basis: `(I, r1)` float32.
    """

    radial_basis: Float32Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "radial_basis", frozen(self.radial_basis, np.float32))
        wanted = (self.parameters.grid.rows, self.parameters.ranks[0])
        if self.radial_basis.shape != wanted:
            raise InvalidMap(f"radial_basis has shape {self.radial_basis.shape}, wanted {wanted}")
        own = harmonic_basis_digest(self.parameters, self.radial_basis)
        if self.digest != own:
            raise InvalidMap(f"the basis says it is {self.digest}, its content is {own}")

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return every array by its name."""
        return {"radial_basis": self.radial_basis}

    def encode(self, image: Image) -> tuple[Signature, ...]:
        """Return the image's one signature, good for all segments."""
        self.require_grid(image)
        values = encode(image.cells, self.radial_basis, self.parameters.ranks[1])
        return (Signature(values.astype(np.complex64), None, self.digest),)
