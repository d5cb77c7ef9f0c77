"""Notes on an anchored map: whether a revision's frame may be another than the live one's."""

from collections.abc import Iterator

import numpy as np

from core.arrays import FloatArray, IntArray
from core.mapping.tensormap import TensorMap
from storage.errors import CorruptFile, RevisionNotFound
from storage.store import Store

_MOST_M = 5.0
"""As far apart as `check` lets the frames of two drives be along the path."""


def anchor_notes(
    store: Store, map_id: str, built: TensorMap, *, is_live: bool = False
) -> Iterator[str]:
    """Yield a note if the map is anchored and a revision moves the drives of its live one.

    The anchor is of the live revision's frame; places on the Earth would be wrong by that way. How
    far it moves is unknown if it has none of these drives.
    """
    of_map = store.maps.get_by_id(map_id)
    digest = of_map.live_revision
    if of_map.anchor is None or digest is None or digest == built.revision:
        return
    try:
        live = store.revisions.read(store.revisions.of_map(map_id, digest))
    except (CorruptFile, RevisionNotFound):  # damaged, or another one is live by now
        return
    yield from frame_notes(live, built, is_live=is_live)


def frame_notes(live: TensorMap, other: TensorMap, *, is_live: bool) -> Iterator[str]:
    """Yield a note if a revision has the drives of the live one elsewhere, or none of them.

    Args:
        live: The live revision, whose frame is the anchor's.
        other: The revision.
        is_live: Whether it becomes live at once, in the place of the other.
    """
    digest = live.revision[:12]
    that = f"revision {digest}, which was live" if is_live else f"live revision {digest}"
    anchor = "the map's anchor is of that one's frame"
    then = "" if is_live else " if this revision becomes live"
    changed = f"{anchor}, set it again{then}"
    ways_m = {name: _moved_m(name, live, other) for name in live.trajectory.drives}
    for name, moved_m in ways_m.items():
        if moved_m is not None and moved_m > _MOST_M:
            yield (
                f"drive {name} is {moved_m:.1f} m (median) from where it is in {that}: {changed}"
            )
            return
    if any(moved_m is not None for moved_m in ways_m.values()):
        return
    aside = live.drives_aside | other.drives_aside
    for name in live.posed_drives:
        if name in aside and name in other.posed_drives:
            yield f"drive {name} is not in the frame of both this revision and {that}: {changed}"
            return
    if live.posed_drives and other.posed_drives:
        yield f"no drive of {that} has a place in this revision: {anchor}, check it{then}"


def _moved_m(name: str, live: TensorMap, built: TensorMap) -> float | None:
    """Return the median way between the places of a drive's scans in two maps, `None` if unknown.

    One that lies beside the others has no place on the Earth.
    """
    if name in live.drives_aside or name in built.drives_aside:
        return None
    (index, places_m), (built_index, built_m) = _places_m(live, name), _places_m(built, name)
    _, rows, built_rows = np.intersect1d(index, built_index, return_indices=True)
    if not len(rows):
        return None
    return float(np.median(np.linalg.norm(places_m[rows] - built_m[built_rows], axis=1)))


def _places_m(of: TensorMap, name: str) -> tuple[IntArray, FloatArray]:
    """Return the indices and places of a drive's scans with a pose, none if the map lacks it."""
    trajectory = of.trajectory
    if name not in trajectory.drives:
        return np.empty(0, np.int64), np.empty((0, 2))
    rows = trajectory.rows_of(name)
    known = trajectory.known[rows]
    return trajectory.scan_index[rows][known], trajectory.poses[rows, :2][known]
