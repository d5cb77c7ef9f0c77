"""The basis that a vehicle downloads once to encode scans on board."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from core.arrays import FloatArray, arrays_of
from core.encodings.signature import Signature
from core.errors import InvalidParameters, SensorMismatch
from core.projection.imager import Image, Views
from core.projection.visibility import FULL_VIEW, View
from core.scans.scan import Scan

if TYPE_CHECKING:
    from core.parameters import MapParameters

_OF_SIGNATURES = ("encoding", "image", "ranks", "reducer", "sensor", "grid", "sensor_height_m")
"""The parameters that a signature depends on; how signatures are compared is none of them."""

_OF_ANY_VIEWS = ("encoding", "image", "reducer", "grid", "views")

_MUCH_WORSE = 1.02
"""Times the error of a refitted basis: docs/decisions/0014-merging-and-basis-identity.md."""


def signature_parameters(parameters: "MapParameters") -> dict[str, Any]:
    """Return the parameters that a signature depends on, as plain values."""
    attributes = {**parameters.as_attributes(), "image": parameters.image.value}
    if parameters.views == Views.FULL:
        return {name: attributes[name] for name in _OF_SIGNATURES}
    # Levelled scans of any sensor at any height are images alike, and ranks are sent as needed.
    of_any = {name: attributes[name] for name in _OF_ANY_VIEWS}
    return {**of_any, "radial_rank": parameters.encoder.kept_ranks(parameters)[0]}


def make_same_signatures(one: "MapParameters", other: "MapParameters") -> bool:
    """Return whether a basis of maps of `one` is valid in maps of `other`.

    All segments must share it.
    """
    return one.encoder.shares_basis and signature_parameters(one) == signature_parameters(other)


@dataclass(frozen=True)
class BasisFit:
    """The fit of a kept basis to one drive.

    Attributes:
        drive: The drive's name.
        kept_error: `radial_error` over the renderings of its scans, U kept.
        refitted_error: The error with U refitted to all available drives.
    """

    drive: str
    kept_error: float
    refitted_error: float

    @property
    def much_worse(self) -> bool:
        """Whether refitting is better by more than it costs vehicles to download a new basis."""
        return self.kept_error > _MUCH_WORSE * self.refitted_error

    def __str__(self) -> str:
        return (
            f"the kept basis leaves out {self.kept_error:.3f} of the detail of drive {self.drive},"
            f" a refitted one would leave out {self.refitted_error:.3f}"
        )


@dataclass(frozen=True, eq=False)
class Basis(ABC):
    """Encodes scans as signatures of one revision; it contains no scan's place.

    Attributes:
        revision: Digest of the map revision.
        digest: The basis's digest, the same in every revision that has it; its signatures name it.
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

    def view(self, image: Image) -> View:
        """Return the part of the place that the image shows, for the same."""
        del image
        return FULL_VIEW

    @abstractmethod
    def encode(self, image: Image, ranks: tuple[int, int] | None = None) -> tuple[Signature, ...]:
        """Return the image's signatures (paper, sec. 2.3).

        Args:
            image: A scan's image.
            ranks: `(r1, r2)`, by default those that the map's parameters ask for. `kept_ranks` say
                the most that its maps can compare.

        Raises:
            SensorMismatch: If the image is of another kind or on another grid.
            InvalidParameters: If its maps do not take these ranks.
        """

    @property
    def kept_ranks(self) -> tuple[int, int]:
        """`(r1, r2)` of what its maps keep of each scan."""
        return self.parameters.encoder.kept_ranks(self.parameters)

    @property
    def least_ranks(self) -> tuple[int, int]:
        """`(r1, r2)` of the smallest signature that its maps compare."""
        return self.kept_ranks

    def require_ranks(self, ranks: tuple[int, int]) -> None:
        """Raise `InvalidParameters` unless its maps take signatures of these ranks."""
        (r1, r2), (most_r1, most_r2) = ranks, self.kept_ranks
        least_r1, least_r2 = self.least_ranks
        if not (least_r1 <= r1 <= most_r1 and least_r2 <= r2 <= most_r2):
            least = "" if self.least_ranks == self.kept_ranks else f"{least_r1} x {least_r2} to "
            raise InvalidParameters(
                f"ranks are {r1} x {r2}, this map takes {least}{most_r1} x {most_r2}"
            )

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return every array by its name."""
        return arrays_of(self)

    def as_values(self) -> dict[str, Any]:
        """Return the arrays as plain values, as `Encoding.read_basis` takes them."""
        return {name: array.tolist() for name, array in self.arrays().items()}

    def fits(self, grams: Mapping[str, FloatArray]) -> tuple[BasisFit, ...]:
        """Compare this basis with one fitted to all of these drives, drive by drive.

        Args:
            grams: The result of `core.encodings.grams.drive_gram` for each drive, by name.

        Returns:
            Nothing if the encoding does not fit its basis to drives.
        """
        return ()

    def serves(self, parameters: "MapParameters") -> bool:
        """Return whether a map of these parameters can keep this basis and its signatures."""
        return make_same_signatures(self.parameters, parameters)

    def image(self, scan: Scan, sensor_height_m: float | None = None) -> Image:
        """Project a scan as the map's own scans were.

        Args:
            scan: The returns.
            sensor_height_m: The height of this scan's sensor, if it is not the map's.

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
