"""The scans that a map is asked about, and what it answers."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from core.arrays import BoolArray, FloatArray, IntArray
from core.errors import InvalidScan
from core.evaluation.condition import Condition
from core.evaluation.motion import is_standing, motion_surrogate
from core.localization.localizer import Localization, Localizer
from core.mapping.tensormap import TensorMap
from core.progress import Progress
from core.scans.drive import Drive
from core.scans.pose import is_known

__all__ = ["Answer", "Queries", "ask", "drive_queries", "held_out_queries"]


@dataclass(frozen=True, eq=False)
class Queries:
    """The scans that are asked, and what is true of them.

    Attributes:
        drive: They are of this one.
        scans: `(n,)` their indices in it.
        segment: `(n,)` where they belong, -1 where no pose tells it.
        standing: `(n,)` whether the vehicle stands, `None` where poses are missing.
        surrogate: `(n,)` the paper's norm of the 6-DOF change.
    """

    drive: Drive
    scans: IntArray
    segment: IntArray
    standing: BoolArray | None
    surrogate: FloatArray


@dataclass(frozen=True)
class Answer:
    """What one query was answered.

    Attributes:
        scan: The query's index in its drive.
        segment: Where it belongs, -1 where no pose tells it.
        matched_scan: The map's scan.
        matched_segment: Its segment.
        matched: `(7,)` its pose row.
        estimated: `(7,)` the vehicle's, that of the map's scan where there is no better.
        heading_told: Whether the encoding tells headings.
        lateral_m: To the left of the map's scan, `None` where the encoding does not tell.
        seconds: From the scan to the answer.
        probability: That the place is right, `None` without a calibration.
        localized: Whether a place was told.
    """

    scan: int
    segment: int
    matched_scan: int
    matched_segment: int
    matched: FloatArray
    estimated: FloatArray
    heading_told: bool
    lateral_m: float | None
    seconds: float
    probability: float | None
    localized: bool


def held_out_queries(drive: Drive, held_out: BoolArray, segment_start: IntArray) -> Queries:
    """Return the scans of the map's own drive that are held out, in the segments cut before.

    Args:
        drive: The map's.
        held_out: `(K,)`, of its scans.
        segment_start: `(L + 1,)` scans at which segments begin, and their number.
    """
    scans = np.flatnonzero(held_out)
    return _queries(drive, scans, np.searchsorted(segment_start, scans, side="right") - 1)


def drive_queries(drive: Drive, tensor_map: TensorMap) -> Queries:
    """Return all scans of another drive, each in the segment of the nearest scan of the map."""
    scans = np.arange(len(drive))
    mapped = tensor_map.trajectory.known
    asked = is_known(drive.poses)
    segment = np.full(len(drive), -1)
    if mapped.any() and asked.any():
        tree = KDTree(tensor_map.trajectory.poses[mapped, :3])
        nearest = np.flatnonzero(mapped)[tree.query(drive.poses[asked, :3])[1]]
        segment[asked] = tensor_map.model.segment_of_scan[nearest]
    return _queries(drive, scans, segment)


def _queries(drive: Drive, scans: IntArray, segment: IntArray) -> Queries:
    known = bool(is_known(drive.poses).all())
    return Queries(
        drive,
        scans,
        segment,
        is_standing(drive.poses, drive.timestamp_s)[scans] if known else None,
        motion_surrogate(drive.poses)[scans],
    )


def ask(
    localizer: Localizer,
    queries: Queries,
    unknown: Sequence[Drive],
    conditions: Sequence[Condition],
    seed: int,
    progress: Progress,
) -> list[tuple[list[Answer], list[Localization]]]:
    """Read each query once and ask it under every condition.

    Args:
        localizer: Who is asked.
        queries: Scans of places in the map.
        unknown: Drives of places that are not.
        conditions: The disturbances.
        seed: Of the noise.
        progress: Told of each query and condition.

    Returns:
        For each condition what the queries were answered, those that were refused left out, and
        what the scans of unknown places were.
    """
    answers: list[list[Answer]] = [[] for _ in conditions]
    elsewhere: list[list[Localization]] = [[] for _ in conditions]
    scans = len(queries.scans) + sum(len(drive) for drive in unknown)
    progress.start("localizing", scans * len(conditions))
    for scan_index, segment in zip(queries.scans.tolist(), queries.segment.tolist(), strict=True):
        found = _asked(localizer, queries.drive, scan_index, conditions, seed, progress)
        for given, asked in zip(answers, found, strict=True):
            if asked is not None:
                given.append(_answer(localizer, *asked, scan_index, segment))
    for drive in unknown:
        for scan_index in range(len(drive)):
            found = _asked(localizer, drive, scan_index, conditions, seed, progress)
            for told, asked in zip(elsewhere, found, strict=True):
                if asked is not None:
                    told.append(asked[0])
    return list(zip(answers, elsewhere, strict=True))


def _asked(
    localizer: Localizer,
    drive: Drive,
    scan_index: int,
    conditions: Sequence[Condition],
    seed: int,
    progress: Progress,
) -> list[tuple[Localization, float] | None]:
    """Return the answers to a scan under every condition and their seconds; `None` for none."""
    try:
        scan = drive.scan(scan_index)
    except InvalidScan:
        progress.advance(len(conditions))
        return [None] * len(conditions)
    answers: list[tuple[Localization, float] | None] = []
    for condition in conditions:
        rng = np.random.default_rng([seed, scan_index])
        try:
            disturbed = condition.apply(scan, rng)
            begun = time.perf_counter()
            found = localizer.localize_scan(disturbed)
            answers.append((found, time.perf_counter() - begun))
        except InvalidScan:
            answers.append(None)
        progress.advance()
    return answers


def _answer(
    localizer: Localizer, found: Localization, seconds: float, scan_index: int, segment: int
) -> Answer:
    best = found.best
    matched, estimated = localizer.map.trajectory.poses[best.row], best.estimated_pose
    return Answer(
        scan_index,
        segment,
        best.scan_index,
        best.segment,
        matched,
        matched if estimated is None else np.array(estimated.as_tuple()),
        best.heading_deg is not None,
        best.lateral_m,
        seconds,
        found.verdict.probability,
        found.localized,
    )
