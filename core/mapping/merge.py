"""Several drives in one map: maps merged, and drives left out."""

from collections.abc import Collection, Sequence

import numpy as np

from core.errors import BasisMismatch, EmptyDrive, InvalidParameters, UnknownDrive
from core.mapping.components import placements_without
from core.mapping.tensormap import TensorMap
from core.scans.trajectory import Trajectory
from core.topology import join_segments


def merge_maps(maps: Sequence[TensorMap]) -> TensorMap:
    """Merge the drives of several maps into one, exactly: no number of any of them changes.

    Harmonic maps must share one radial basis, that is, all but the first were built with the first
    one's: the result is that of a build of all drives with that basis. The paper's segments have
    bases of their own and are concatenated: the result is that of a build of all drives. (But for
    the segments of drives that meet: a build cuts there, see `core.topology`.) In both cases a
    vehicle's basis of the first map stays valid.

    Args:
        maps: The maps, at least one, of the same parameters, no drive in two of them.

    Raises:
        InvalidParameters: If there is none, their parameters differ, or a drive is in two.
        BasisMismatch: If harmonic ones differ in their radial basis.
    """
    if not maps:
        raise InvalidParameters("there is no map to merge")
    first = maps[0]
    for other in maps[1:]:
        _require_alike(first, other)
    names = [name for part in maps for name in part.trajectory.drives]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InvalidParameters(
            f"drive {twice[0]!r} is in several of the maps: leave it out of one"
        )
    if len(maps) == 1:
        return first
    offsets = np.cumsum([0, *(len(part) for part in maps)])
    starts = [part.model.segment_start[:-1] + at for part, at in zip(maps, offsets, strict=False)]
    model = first.model.joined(
        [part.model for part in maps[1:]], np.concatenate([*starts, offsets[-1:]])
    )
    trajectory = Trajectory.concatenate([part.trajectory for part in maps])
    return TensorMap(
        first.parameters,
        model,
        trajectory,
        join_segments(trajectory, model.segment_start),
        np.concatenate([part.relative_error for part in maps]),
        placements={
            name: placement for part in maps for name, placement in part.placements.items()
        },
        computed_poses=tuple(name for part in maps for name in part.computed_poses),
    )


def without_drives(tensor_map: TensorMap, names: Collection[str]) -> TensorMap:
    """Return the map without some of its drives; the others do not change.

    Raises:
        UnknownDrive: If it has no such drive.
        EmptyDrive: If none would be left.
    """
    drives = tensor_map.trajectory.drives
    unknown = sorted(set(names) - set(drives))
    if unknown:
        raise UnknownDrive(f"the map has no drive {unknown[0]!r}, it has {', '.join(drives)}")
    kept = [position for position, name in enumerate(drives) if name not in names]
    if not kept:
        raise EmptyDrive("no drive would be left in the map")
    if len(kept) == len(drives):
        return tensor_map
    rows = np.flatnonzero(np.isin(tensor_map.trajectory.drive_of_scan, kept))
    model = tensor_map.model
    segments = np.flatnonzero(np.isin(model.segment_start[:-1], rows))
    starts = np.cumsum([0, *np.diff(model.segment_start)[segments]])
    trajectory = tensor_map.trajectory.select(rows)
    return TensorMap(
        tensor_map.parameters,
        model.select(rows, segments, starts),
        trajectory,
        join_segments(trajectory, starts),
        tensor_map.relative_error[segments],
        placements=placements_without(tensor_map.posed_drives, tensor_map.placements, names),
        computed_poses=tuple(name for name in tensor_map.computed_poses if name not in names),
    )


def _require_alike(first: TensorMap, other: TensorMap) -> None:
    one, two = first.parameters.as_attributes(), other.parameters.as_attributes()
    if one != two:
        name = next(name for name in {**one, **two} if one.get(name) != two.get(name))
        raise InvalidParameters(
            f"{name} is {two.get(name)} in the map of {', '.join(other.trajectory.drives)},"
            f" {one.get(name)} in that of {', '.join(first.trajectory.drives)}"
        )
    shared = first.parameters.encoder.shares_basis
    if shared and first.basis_digest != other.basis_digest:
        raise BasisMismatch(
            f"the map of {', '.join(other.trajectory.drives)} has basis {other.basis_digest[:16]},"
            f" that of {', '.join(first.trajectory.drives)} has {first.basis_digest[:16]}: build it"
            " with the first one's basis, or one map of all drives"
        )
