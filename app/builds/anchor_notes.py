"""Notes of a build of an anchored map: whether it puts drives elsewhere than the live revision."""

from collections.abc import Iterator

import numpy as np

from core.arrays import FloatArray, IntArray
from core.mapping.tensormap import TensorMap
from storage.errors import CorruptFile, RevisionNotFound
from storage.store import Store

_MOST_M = 5.0
"""As far apart as `check` lets the frames of two drives be along the path."""


def anchor_notes(store: Store, map_id: str, built: TensorMap) -> Iterator[str]:
    """Yield a note if the map is anchored and a build moves the drives of its live revision.

    The anchor is of the live revision's frame; places on the Earth would be wrong by that way.
    """
    of_map = store.maps.get_by_id(map_id)
    digest = of_map.live_revision
    if of_map.anchor is None or digest is None or digest == built.revision:
        return
    try:
        live = store.revisions.read(store.revisions.of_map(map_id, digest))
    except (CorruptFile, RevisionNotFound):  # damaged, or another one is live by now
        return
    for name in live.trajectory.drives:
        moved_m = _moved_m(name, live, built)
        if moved_m > _MOST_M:
            yield (
                f"drive {name} is {moved_m:.1f} m (median) from where it is in live revision"
                f" {digest[:12]}: the map's anchor is of that one's frame, set it again if"
                " this revision becomes live"
            )
            return


def _moved_m(name: str, live: TensorMap, built: TensorMap) -> float:
    """Return the median way between the places of a drive's scans in two maps, 0 if unknown.

    One that lies beside the others has no place on the Earth.
    """
    for one in (live, built):
        placement = one.placements.get(name)
        if placement is not None and placement.is_aside:
            return 0.0
    (index, places_m), (built_index, built_m) = _places_m(live, name), _places_m(built, name)
    _, rows, built_rows = np.intersect1d(index, built_index, return_indices=True)
    if not len(rows):
        return 0.0
    return float(np.median(np.linalg.norm(places_m[rows] - built_m[built_rows], axis=1)))


def _places_m(of: TensorMap, name: str) -> tuple[IntArray, FloatArray]:
    """Return the indices and places of a drive's scans with a pose, none if the map lacks it."""
    trajectory = of.trajectory
    if name not in trajectory.drives:
        return np.empty(0, np.int64), np.empty((0, 2))
    rows = trajectory.known & (trajectory.drive_of_scan == trajectory.drives.index(name))
    return trajectory.scan_index[rows], trajectory.poses[rows, :2]
