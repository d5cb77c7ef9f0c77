"""What a vehicle downloads once to make signatures on board."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from core.arrays import FloatArray, arrays_of
from core.encodings.signature import Signature
from core.errors import SensorMismatch
from core.projection.imager import Image
from core.scans.scan import Scan

if TYPE_CHECKING:
    from core.parameters import MapParameters

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

_MUCH_WORSE = 1.02
"""Of the error that a refitted basis leaves: docs/decisions/0014-merging-and-basis-identity.md."""


def signature_parameters(parameters: "MapParameters") -> dict[str, Any]:
    """Return the parameters that a signature depends on, as plain values."""
    attributes = {**parameters.as_attributes(), "image": parameters.image.value}
    return {name: attributes[name] for name in _OF_SIGNATURES}


def make_same_signatures(one: "MapParameters", other: "MapParameters") -> bool:
    """Return whether a basis of maps of `one` makes the signatures of maps of `other` too.

    It must be one for all segments.
    """
    return one.encoder.shares_basis and signature_parameters(one) == signature_parameters(other)


@dataclass(frozen=True)
class BasisFit:
    """How well a basis that was kept fits one drive.

    Attributes:
        drive: Its name.
        kept_error: `radial_error` over the renderings of its scans, U kept.
        refitted_error: The same with U fitted anew to all drives that are at hand.
    """

    drive: str
    kept_error: float
    refitted_error: float

    @property
    def much_worse(self) -> bool:
        """Whether refitting would be worth asking vehicles to download their basis again."""
        return self.kept_error > _MUCH_WORSE * self.refitted_error

    def __str__(self) -> str:
        return (
            f"the basis that was kept leaves out {self.kept_error:.3f} of the detail of drive"
            f" {self.drive}, one fitted anew would leave out {self.refitted_error:.3f}"
        )


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
    parameters: "MapParameters"

    @abstractmethod
    def project(self, image: Image) -> NDArray[Any]:
        """Return the values of the image's signatures, as `Model.search_values` takes them.

        Raises:
            SensorMismatch: If the image is of another kind or on another grid.
        """

    @abstractmethod
    def encode(self, image: Image) -> tuple[Signature, ...]:
        """Return the image's signatures (paper, sec. 2.3).

        Raises:
            SensorMismatch: If the image is of another kind or on another grid.
        """

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return every array by its name."""
        return arrays_of(self)

    def as_values(self) -> dict[str, Any]:
        """Return the arrays as plain values, as `Encoding.read_basis` takes them."""
        return {name: array.tolist() for name, array in self.arrays().items()}

    def fits(self, grams: Mapping[str, FloatArray]) -> tuple[BasisFit, ...]:
        """Compare this basis with one fitted to all of these drives, drive by drive.

        Args:
            grams: What `core.encodings.grams.drive_gram` gave for each drive, by name.

        Returns:
            Nothing if the encoding fits its basis to no drive.
        """
        return ()

    def serves(self, parameters: "MapParameters") -> bool:
        """Return whether a map of these parameters can keep this basis.

        Signatures made with it then stay good.
        """
        return make_same_signatures(self.parameters, parameters)

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
        if image.kind != self.parameters.image:
            raise SensorMismatch(
                f"the image is a {image.kind} image, the map is of {self.parameters.image} images"
            )
        if image.grid != self.parameters.grid:
            raise SensorMismatch(f"the image is on {image.grid}, the map on {self.parameters.grid}")
