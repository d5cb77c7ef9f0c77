"""The descriptor of a scan in a baseline, and the search among the descriptors of places."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from typing import Any

import numpy as np

from core.arrays import Float32Array, IntArray
from core.errors import EmptyDrive, InvalidScan
from core.evaluation.methods import Enrolled, Match, Nearest
from core.progress import NO_PROGRESS, Progress
from core.projection.images import Skipped
from core.scans.angles import wrapped_deg
from core.scans.drive import Drive
from core.scans.scan import Scan

_FLOAT32_BYTES = 4


class Places(ABC):
    """Descriptors of known places, ready to be searched.

    Attributes:
        stored_bytes: Size of all places in a file, without what can be derived from it.
    """

    def __init__(self, descriptors: Float32Array) -> None:
        self.stored_bytes = descriptors.astype(np.float32).nbytes
        self._count = len(descriptors)

    def __len__(self) -> int:
        return self._count

    def nearest(self, descriptor: Float32Array, before: int | None = None) -> Nearest | None:
        """Return the most similar place, the first among equals; `None` if there is none.

        Args:
            descriptor: The query's descriptor.
            before: Search the rows below this one only; all of them without it.
        """
        last = len(self) if before is None else min(before, len(self))
        return self._nearest(descriptor, last) if last > 0 else None

    @abstractmethod
    def _nearest(self, descriptor: Float32Array, last: int) -> Nearest:
        """Return the most similar place of the rows below `last`, at least one."""


class PlaceDescriptor(ABC):
    """A method with a descriptor of fixed shape for a scan; its parameters are its fields.

    The same scan always has the same descriptor, which does not depend on the order of the returns
    but for the rounding of sums.
    """

    @property
    @abstractmethod
    def name(self) -> str:
        """A short name, for tables and options."""

    @property
    @abstractmethod
    def shape(self) -> tuple[int, ...]:
        """The shape of a descriptor."""

    @abstractmethod
    def describe(self, scan: Scan) -> Float32Array:
        """Return the scan's descriptor, of `shape`.

        Raises:
            InvalidScan: If the scan cannot be described.
        """

    @abstractmethod
    def places(self, descriptors: Float32Array) -> Places:
        """Return places to search, of `(K, *shape)` descriptors."""

    def configuration(self) -> dict[str, Any]:
        """Return all parameters."""
        return asdict(self)  # type: ignore[call-overload, no-any-return]

    def enrol(self, drive: Drive, scans: IntArray, progress: Progress = NO_PROGRESS) -> Enrolled:
        """Describe the scans one by one; one that cannot be used is left out."""
        described: list[Float32Array] = []
        kept = enrol_each(
            self.name, drive, scans, lambda scan: described.append(self.describe(scan)), progress
        )
        places = self.places(np.stack(described))

        def describe(scan: Scan) -> Match:
            return partial(places.nearest, self.describe(scan))

        sent_bytes = _FLOAT32_BYTES * math.prod(self.shape)
        return Enrolled(kept, sent_bytes, places.stored_bytes / len(kept), describe)


def enrol_each(
    name: str,
    drive: Drive,
    scans: IntArray,
    enrol: Callable[[Scan], None],
    progress: Progress = NO_PROGRESS,
) -> IntArray:
    """Enrol scans one by one and return the usable ones.

    Raises:
        EmptyDrive: If not one of them is usable.
    """
    progress.start(name, len(scans))
    kept: list[int] = []
    skipped: list[Skipped] = []
    for index in scans.tolist():
        try:
            enrol(drive.scan(index))
            kept.append(index)
        except InvalidScan as error:
            skipped.append(Skipped(index, str(error)))
        progress.advance()
    if not kept:
        raise EmptyDrive(Skipped.explain(drive, skipped))
    return np.array(kept, dtype=np.int64)


def relative_yaw_deg(shift: int, sectors: int) -> float:
    """Return the relative yaw of a shift by `shift` of `sectors`, in -180..180 degrees.

    Examples:
        >>> relative_yaw_deg(15, 60), relative_yaw_deg(45, 60)
        (90.0, -90.0)
    """
    return wrapped_deg(shift * 360.0 / sectors)
