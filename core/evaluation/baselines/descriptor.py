"""What a peer gives: a scan's descriptor, and the places among which it is looked for."""

from dataclasses import dataclass
from typing import Any, Protocol

from core.arrays import Float32Array
from core.errors import InvalidParameters
from core.scans.angles import wrapped_deg
from core.scans.scan import Scan

__all__ = ["Nearest", "PlaceDescriptor", "Places", "require_descriptors", "sent_bytes", "turn_deg"]

_FLOAT32_BYTES = 4


@dataclass(frozen=True)
class Nearest:
    """The place that is most like a query.

    Attributes:
        row: Its row among the places.
        distance: How unlike it is, smaller is nearer; comparable between queries of one method.
        turn_deg: How far the query is turned from it, counter-clockwise, -180..180; `None` where
            the method does not tell.
    """

    row: int
    distance: float
    turn_deg: float | None = None


class Places(Protocol):
    """Descriptors of known places, ready to be searched."""

    def __len__(self) -> int:
        """Return how many places there are."""

    @property
    def stored_bytes(self) -> int:
        """What a file must hold of all places; what is derived when it is read does not count."""

    def nearest(self, descriptor: Float32Array, before: int | None = None) -> Nearest | None:
        """Return the most similar place, the first among equals; `None` if there is none.

        Args:
            descriptor: Of the query.
            before: Search the rows below this one only; all of them without it.
        """


class PlaceDescriptor(Protocol):
    """How a scan becomes a descriptor of fixed shape.

    It is the same for the same scan whenever it is asked for, and independent of the order of the
    returns but for the rounding of sums.
    """

    @property
    def name(self) -> str:
        """A short name, for tables and options."""

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of a descriptor."""

    def configuration(self) -> dict[str, Any]:
        """Return all parameters as plain values."""

    def describe(self, scan: Scan) -> Float32Array:
        """Return the scan's descriptor, of `shape`.

        Raises:
            InvalidScan: If the scan holds nothing that can be described.
        """

    def places(self, descriptors: Float32Array) -> Places:
        """Return places to search, of `(K, *shape)` descriptors.

        Raises:
            InvalidParameters: If they have another shape.
        """


def sent_bytes(descriptor: PlaceDescriptor) -> int:
    """Return what a vehicle sends: every number of a descriptor as float32."""
    numbers = 1
    for length in descriptor.shape:
        numbers *= length
    return _FLOAT32_BYTES * numbers


def require_descriptors(descriptors: Float32Array, shape: tuple[int, ...]) -> None:
    """Refuse arrays that are not `(K, *shape)`.

    Raises:
        InvalidParameters: If they are not.
    """
    if descriptors.shape[1:] != shape or descriptors.ndim != len(shape) + 1:
        raise InvalidParameters(
            f"descriptors have shape {descriptors.shape}, wanted (K, {', '.join(map(str, shape))})"
        )


def turn_deg(shift: int, sectors: int) -> float:
    """Return the turn that moves a descriptor by `shift` of its `sectors`, in -180..180 degrees.

    Examples:
        >>> turn_deg(15, 60), turn_deg(45, 60)
        (90.0, -90.0)
    """
    return wrapped_deg(shift * 360.0 / sectors)
