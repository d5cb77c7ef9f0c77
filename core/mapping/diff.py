"""The content of two maps, and their differences."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from core.mapping.tensormap import TensorMap


@dataclass(frozen=True)
class MapFacts:
    """A map in numbers.

    Attributes:
        revision: Its digest.
        basis: Digest of its basis.
        scans: K.
        segments: L.
        drives: In their order.
        relative_error_median: Of its segments, 0..1: what signatures leave out of the images.
        relative_error_largest: Likewise.
        calibrated: Whether its answers have a probability.
        threshold: Below this probability an answer is a refusal; `None` if it is not calibrated.
        nodes: Of its graph.
        edges: Of its graph.
        length_m: Of all edges together, `None` where a pose on the way is unknown.
    """

    revision: str
    basis: str
    scans: int
    segments: int
    drives: tuple[str, ...]
    relative_error_median: float
    relative_error_largest: float
    calibrated: bool
    threshold: float | None
    nodes: int
    edges: int
    length_m: float | None

    @classmethod
    def of(cls, tensor_map: TensorMap) -> "MapFacts":
        """Return the facts about a map."""
        topology, calibration = tensor_map.topology, tensor_map.calibration
        length_m = float(topology.edge_length_m.sum())
        return cls(
            revision=tensor_map.revision,
            basis=tensor_map.basis_digest,
            scans=len(tensor_map),
            segments=tensor_map.model.segments,
            drives=tensor_map.trajectory.drives,
            relative_error_median=float(np.median(tensor_map.relative_error)),
            relative_error_largest=float(tensor_map.relative_error.max()),
            calibrated=calibration is not None,
            threshold=None if calibration is None else calibration.threshold,
            nodes=len(topology.node_scan),
            edges=topology.edges,
            length_m=None if np.isnan(length_m) else length_m,
        )


@dataclass(frozen=True)
class DriveOverlap:
    """How many scans of a drive two maps have.

    Attributes:
        drive: Its name.
        in_both: Scans that both have.
        only_this: Scans that only the first map has.
        only_other: Scans that only the second map has.
    """

    drive: str
    in_both: int
    only_this: int
    only_other: int


def drive_overlaps(
    this: TensorMap, other: TensorMap, *, recorded_anew: frozenset[str] = frozenset()
) -> tuple[DriveOverlap, ...]:
    """Return how many scans of each drive two maps have: this one's drives, then the other's.

    Args:
        this: A map.
        other: Another.
        recorded_anew: Names of drives that are another recording in each of them.
    """
    mine, theirs = _indices(this), _indices(other)
    overlaps = []
    for drive in dict.fromkeys([*mine, *theirs]):
        here, there = mine.get(drive, frozenset()), theirs.get(drive, frozenset())
        both = 0 if drive in recorded_anew else len(here & there)
        overlaps.append(DriveOverlap(drive, both, len(here) - both, len(there) - both))
    return tuple(overlaps)


def changed_parameters(
    this: Mapping[str, Any], other: Mapping[str, Any]
) -> dict[str, tuple[Any, Any]]:
    """Return the differences of two sets of parameters, `None` for what one does not have.

    Examples:
        >>> changed_parameters({"ranks": [5, 5], "image": "height"}, {"ranks": [1, 1]})
        {'image': ('height', None), 'ranks': ([5, 5], [1, 1])}
    """
    return {
        name: (this.get(name), other.get(name))
        for name in sorted({*this, *other})
        if this.get(name) != other.get(name)
    }


def _indices(tensor_map: TensorMap) -> dict[str, frozenset[int]]:
    trajectory = tensor_map.trajectory
    starts = trajectory.drive_start.tolist()
    return {
        drive: frozenset(trajectory.scan_index[first:end].tolist())
        for drive, first, end in zip(trajectory.drives, starts, starts[1:], strict=False)
    }
