"""Methods of place recognition: what a comparison needs of one, and TensorMap as one."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import numpy as np

from core.arrays import IntArray
from core.encodings.search import Search
from core.encodings.signature import pack_signatures
from core.mapping.estimate import estimate
from core.mapping.pipeline import build, project_scans
from core.mapping.tensormap import TensorMap
from core.numbers import none_if_nan
from core.parameters import MapParameters
from core.progress import NO_PROGRESS, Progress
from core.scans.drive import Drive, scan_index_of
from core.scans.scan import Scan
from core.segmentation.fixed import cut_fixed


@dataclass(frozen=True)
class Nearest:
    """The place that is most like a query.

    Attributes:
        row: The place's row among the places.
        distance: Smaller is nearer; comparable between queries of one method.
        relative_yaw_deg: Relative yaw of the query, counter-clockwise, -180..180; `None` where
            the method does not estimate it.
    """

    row: int
    distance: float
    relative_yaw_deg: float | None = None


Match = Callable[[int | None], Nearest | None]
"""Matches a described query: given how many of the first rows are searched (`None`: all), returns
the nearest place among them, or `None` where the method has no answer."""


@dataclass(frozen=True, eq=False)
class Enrolled:
    """The places of a drive in one method.

    Attributes:
        scans: The scans of the drive that are places, rising; those that could not be used lack.
        sent_bytes: Size of a query as a vehicle sends it; `None` where it is not fixed.
        stored_bytes: Size of a stored place; `None` where it is unknown.
        describe: Describes a query and returns what matches it; may raise `InvalidScan`.
    """

    scans: IntArray
    sent_bytes: float | None
    stored_bytes: float | None
    describe: Callable[[Scan], Match]


class Method(Protocol):
    """A method of place recognition."""

    @property
    def name(self) -> str:
        """A short name, for tables and options."""

    def configuration(self) -> dict[str, Any]:
        """Return all parameters as plain values."""

    def enrol(self, drive: Drive, scans: IntArray, progress: Progress = NO_PROGRESS) -> Enrolled:
        """Make places of some scans of a drive.

        Args:
            drive: The drive.
            scans: Which of its scans, rising.
            progress: Receives each scan.

        Raises:
            EmptyDrive: If not one of them is usable.
        """


@dataclass(frozen=True)
class MappedPlaces:
    """A TensorMap as a `Method`.

    The bases are fitted to all enrolled scans at once, also when queries may only be compared with
    earlier ones: a map is built after its drive.

    Attributes:
        parameters: What the map is built with.
        segment_length: k in scans of the drive, as in an evaluation.
        by_scan: Whether queries are whole scans, and not signatures.
    """

    parameters: MapParameters
    segment_length: int
    by_scan: bool = False

    @property
    def name(self) -> str:
        """The encoding; of whole scans `-scan` after it."""
        return f"{self.parameters.encoding}{'-scan' if self.by_scan else ''}"

    def configuration(self) -> dict[str, Any]:
        """Return the map's parameters."""
        return {**self.parameters.as_attributes(), "segment_length": self.segment_length}

    def enrol(self, drive: Drive, scans: IntArray, progress: Progress = NO_PROGRESS) -> Enrolled:
        """Build a map of the scans."""
        tensor_map = build(
            [drive],
            self.parameters,
            lambda _: project_scans(drive, scans, self.parameters, progress, most_probes=0),
            segment_start=cut_fixed(len(drive), self.segment_length),
            calibrated=False,
            progress=progress,
        ).tensor_map
        kept = np.searchsorted(scan_index_of(drive), tensor_map.trajectory.scan_index)
        basis = tensor_map.basis()
        first = basis.encode(basis.image(drive.scan(int(kept[0]))))
        stored = sum(array.nbytes for array in tensor_map.model.arrays().values())
        if not self.by_scan:
            stored -= tensor_map.verification_bytes

        def describe(scan: Scan) -> Match:
            image, model = basis.image(scan), tensor_map.model
            if self.by_scan:
                return partial(
                    _nearest_in_map, tensor_map, lambda: model.search_image(image, basis)
                )
            signatures = basis.encode(image)
            return partial(_nearest_in_map, tensor_map, lambda: model.search(signatures))

        sent = None if self.by_scan else len(pack_signatures(first))
        return Enrolled(kept, sent, stored / len(kept), describe)


def _nearest_in_map(
    tensor_map: TensorMap, search: Callable[[], Search], before: int | None
) -> Nearest | None:
    among = None if before is None else np.arange(len(tensor_map)) < before
    of_query = search()
    found = of_query.nearest(1, among)
    if not len(found):
        return None
    row, yaw_deg = int(found.rows[0]), none_if_nan(found.relative_yaw_deg[0])
    if yaw_deg is not None:  # that of an answer, not of the best rendering
        yaw_deg = estimate(of_query, tensor_map.trajectory, row, yaw_deg, among).relative_yaw_deg
    return Nearest(row, float(found.distances[0]), yaw_deg)
