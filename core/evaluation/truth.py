"""Notes on evaluations whose figures say little, since the truth is not known or not there."""

from collections.abc import Iterable, Iterator

import numpy as np

from core.evaluation.nearest import nearest_place
from core.scans.drive import Drive
from core.scans.pose import is_known
from core.text import count_of


def truth_notes(mapped: Drive, queried: Drive | None, within_m: float) -> Iterator[str]:
    """Yield a note on drives without poses, and on queries of places that are not mapped.

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
    queries = queried.poses[is_known(queried.poses)]
    _, nearest_m = nearest_place(mapped.poses, queries)
    away = int((nearest_m > within_m).sum())
    if away == len(queries):
        yield (
            f"none of {len(queries)} queries of {queried.name} is within {within_m:g} m of a scan"
            f" of {mapped.name}, so that none has a right answer: are both in one world frame?"
        )
    elif away:
        yield (
            f"{away} of {len(queries)} queries of {queried.name} have no place within"
            f" {within_m:g} m in {mapped.name}: no recall counts them"
        )


def left_out_notes(*drives: Drive | None) -> Iterator[str]:
    """Yield a note on each drive some of whose scans are left out, as they have no pose."""
    for unposed in _partly_unposed(drives):
        yield f"{unposed} have no pose and are left out"


def uncounted_notes(*drives: Drive | None) -> Iterator[str]:
    """Yield a note on each drive some of whose scans are not counted, as they have no pose."""
    for unposed in _partly_unposed(drives):
        yield f"{unposed} have no pose: no recall counts them, nor answers that name them"


def _partly_unposed(drives: Iterable[Drive | None]) -> Iterator[str]:
    """Yield how many scans of a drive are without a pose, if others have one."""
    for drive in drives:
        known = is_known(drive.poses) if drive is not None else np.ones(0, bool)
        if drive is not None and known.any() and not known.all():
            yield f"{(~known).sum()} of {count_of(len(known), 'scan')} of {drive.name}"
