"""Notes on evaluations whose figures say little, since the truth is not known or not there."""

from collections.abc import Iterator

import numpy as np
from scipy.spatial import KDTree

from core.scans.drive import Drive
from core.scans.pose import is_known


def truth_notes(mapped: Drive, queried: Drive | None, within_m: float) -> Iterator[str]:
    """Yield a note on drives without poses, and on two that share no place.

    Args:
        mapped: The drive that is mapped.
        queried: The drive of the queries; `None` if they are a part of `mapped`.
        within_m: The distance within which a match is right.
    """
    drives = [drive for drive in (mapped, queried) if drive is not None]
    unposed = [drive for drive in drives if not is_known(drive.poses).any()]
    for drive in unposed:
        what = "only the segment" if queried is None else "none"
        yield f"drive {drive.name} has no poses: {what} of an answer can be checked"
    if queried is None or unposed:
        return
    places_m, queries_m = (drive.poses[is_known(drive.poses), :3] for drive in drives)
    nearest_m, _ = KDTree(places_m).query(queries_m, distance_upper_bound=within_m)
    if not np.isfinite(nearest_m).any():
        yield (
            f"none of {len(queries_m)} queries of {queried.name} is within {within_m:g} m of a scan"
            f" of {mapped.name}, so that each answer counts as wrong: are both in one world frame?"
        )
