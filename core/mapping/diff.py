"""The scans that two maps have in common."""

from dataclasses import dataclass

from core.mapping.tensormap import TensorMap


@dataclass(frozen=True)
class DriveOverlap:
    """Numbers of scans of a drive in two maps.

    Attributes:
        drive: The drive's name.
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
    """Return the overlap of each drive: those of `this`, then those of `other` only.

    Args:
        this: A map.
        other: Another.
        recorded_anew: Names with another recording in each of them.
    """
    mine, theirs = _indices(this), _indices(other)
    overlaps = []
    for drive in dict.fromkeys([*mine, *theirs]):
        here, there = mine.get(drive, frozenset()), theirs.get(drive, frozenset())
        both = 0 if drive in recorded_anew else len(here & there)
        overlaps.append(DriveOverlap(drive, both, len(here) - both, len(there) - both))
    return tuple(overlaps)


def _indices(tensor_map: TensorMap) -> dict[str, frozenset[int]]:
    trajectory = tensor_map.trajectory
    return {
        drive: frozenset(trajectory.scan_index[trajectory.rows_of(drive)].tolist())
        for drive in trajectory.drives
    }
