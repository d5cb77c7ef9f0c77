"""What a baseline gives: a scan's descriptor, and the places among which it is searched for."""

import math
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import numpy as np

from core.arrays import Float32Array, IntArray
from core.errors import EmptyDrive, InvalidParameters, InvalidScan
from core.evaluation.methods import Ask, Enrolled, EnrolledPlaces, Nearest
from core.progress import NO_PROGRESS, Progress
from core.projection.images import Skipped
from core.scans.drive import Drive
from core.scans.scan import Scan

__all__ = [
    "DescribedPlaces",
    "PlaceDescriptor",
    "Places",
    "require_descriptors",
    "sent_bytes",
    "turn_deg",
]

_FLOAT32_BYTES = 4


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


@dataclass(frozen=True, eq=False)
class DescribedPlaces:
    """A baseline whose descriptors have a fixed shape, as a `Method`."""

    descriptor: PlaceDescriptor

    @property
    def name(self) -> str:
        """The baseline's name."""
        return self.descriptor.name

    def configuration(self) -> dict[str, Any]:
        """Return the baseline's parameters."""
        return self.descriptor.configuration()

    def enrol(self, drive: Drive, scans: IntArray, progress: Progress = NO_PROGRESS) -> Enrolled:
        """Describe the scans one by one; one that cannot be used is left out."""
        progress.start(self.name, len(scans))
        kept, described, skipped = [], [], []
        for index in scans.tolist():
            try:
                described.append(self.descriptor.describe(drive.scan(index)))
                kept.append(index)
            except InvalidScan as error:
                skipped.append(Skipped(index, str(error)))
            progress.advance()
        if not kept:
            raise EmptyDrive(Skipped.explain(drive.name, skipped))
        places = self.descriptor.places(np.stack(described))

        def describe(scan: Scan) -> Ask:
            return partial(places.nearest, self.descriptor.describe(scan))

        return EnrolledPlaces(
            np.array(kept, dtype=np.int64),
            sent_bytes(self.descriptor),
            places.stored_bytes / len(kept),
            describe,
        )


def sent_bytes(descriptor: PlaceDescriptor) -> int:
    """Return what a vehicle sends: every number of a descriptor as float32."""
    return _FLOAT32_BYTES * math.prod(descriptor.shape)


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
    return (shift * 360.0 / sectors + 180.0) % 360.0 - 180.0
