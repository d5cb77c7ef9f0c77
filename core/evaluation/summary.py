"""The metrics of the answers under one condition."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from core.arrays import BoolArray, FloatArray
from core.confidence.places import AWAY_M
from core.evaluation.condition import Condition
from core.evaluation.metrics import apart_m, heading_error_deg, median
from core.evaluation.nearest import nearest_place, recalls_within
from core.evaluation.plain import Plain, plain
from core.evaluation.query_set import LocatedQueries
from core.evaluation.reliability import Outcome, Reliability, reliability
from core.localization.localizer import Localization
from core.localization.match import Match
from core.mapping.tensormap import TensorMap
from core.numbers import none_if_nan
from core.scans.displacement import left_of_m
from core.scans.drive import scan_index_of
from core.scans.pose import heading_deg, pose_rows

SAME_PLACE_M = 3.0
"""A scan that was recorded so near the query is of its place, on whichever segment it is."""


@dataclass(frozen=True)
class SegmentError:
    """A query that was matched on a wrong segment.

    Attributes:
        scan: The query's index in its drive.
        matched_scan: Index of the matched map scan.
        segment: The true one.
        matched_segment: The one of the matched scan.
        apart_m: How far apart the two were recorded, `None` where unknown.
        standing: Whether the vehicle was stationary, `None` without poses.
        motion_surrogate: The paper's norm of the 6-DOF change, `None` without poses.
    """

    scan: int
    matched_scan: int
    segment: int
    matched_segment: int
    apart_m: float | None
    standing: bool | None
    motion_surrogate: float | None


@dataclass(frozen=True)
class ConditionResult(Plain):
    """All queries under one condition; `None` where not applicable.

    Distances in metres are the keys of mappings: a query is *findable* within so many metres if a
    scan of the map was recorded so near, and an answer is right if the scan that it names was. Near
    is of the place where the query was recorded, as in the paper, also under a lateral offset; only
    the errors of positions are of the displaced vehicle.

    Attributes:
        condition: The disturbance.
        queries: How many scans were queried.
        refusals: How many got no answer; they count in no figure below.
        segment_accuracy: Share of answers on the right segment.
        errors: Answers on a wrong segment, one by one.
        errors_moving: How many of them while the vehicle moved.
        errors_stationary: How many while it was stationary.
        errors_same_place: How many of the errors matched a scan recorded within 3 m of the query: a
            right place, on another pass or beyond a cut. `None` without poses.
        findable: How many queries with an answer had something to find.
        recall_at_1: Share of these whose answer is right.
        position_error_m_median: Median distance of the estimated position, or of the matched scan
            where none is estimated, from the displaced vehicle.
        nearest_scan_m_median: Median distance of the map's nearest scan from the displaced vehicle:
            the error of a position that is always a scan's.
        heading_error_deg_median: Median error of the estimated heading; the paper's encoding
            estimates none.
        lateral_error_m_median: Median error of the estimated offset to the left of the matched
            scan; the paper's encoding estimates none.
        ms_per_query: Median wall time from returns to answer, projection included.
        ms_slowest: The longest, which holds what the first query alone prepares.
        reliability: The reliability of the probabilities; `None` without calibration or poses.
            Known places are those of queries that are findable within the greatest distance, as for
            the novelty AUROC of `compare`; the other queries of these drives are left out.
    """

    condition: Condition
    queries: int
    refusals: int
    segment_accuracy: float | None
    errors: tuple[SegmentError, ...]
    errors_moving: int | None
    errors_stationary: int | None
    errors_same_place: int | None
    findable: dict[float, int]
    recall_at_1: dict[float, float | None]
    position_error_m_median: float | None
    nearest_scan_m_median: float | None
    heading_error_deg_median: float | None
    lateral_error_m_median: float | None
    ms_per_query: float | None
    ms_slowest: float | None
    reliability: Reliability | None

    def as_dict(self) -> dict[str, Any]:
        """Return plain values, `errors` as their number."""
        found = super().as_dict()
        return {
            **found.pop("condition"),
            **found,
            "errors": None if self.segment_accuracy is None else len(self.errors),
            "error_scans": found["errors"],
        }


@dataclass(frozen=True)
class Answer:
    """A localization and its time from scan to answer."""

    found: Localization
    seconds: float


def summarize(
    condition: Condition,
    tensor_map: TensorMap,
    queries: LocatedQueries,
    answers: Sequence[Answer | None],
    elsewhere: Sequence[Answer | None],
    tolerances_m: Sequence[float],
) -> ConditionResult:
    """Return the metrics of a map's answers under one condition.

    Args:
        condition: The disturbance.
        tensor_map: The map.
        queries: All that were queried.
        answers: The answer to each of them, `None` where it was rejected.
        elsewhere: The answers to scans of places that are not in the map.
        tolerances_m: Within which a match counts as recalled.
    """
    answered, given = queries.answered(answers)
    best = [answer.found.best for answer in given]
    true = np.array([condition.pose(pose) for pose in answered.poses]).reshape(-1, 7)
    matched = tensor_map.trajectory.poses[np.array([match.row for match in best], np.int64)]
    estimated = pose_rows([match.estimated_pose or match.pose for match in best])
    recorded_m = apart_m(matched, answered.poses)
    errors = _segment_errors(answered, best, recorded_m)
    checked = int((answered.segment >= 0).sum())
    standing = same_place = None
    if answered.standing is not None and checked:
        standing = sum(bool(error.standing) for error in errors)
        same_place = sum(
            error.apart_m is not None and error.apart_m <= SAME_PLACE_M for error in errors
        )
    has_heading = np.array([match.heading_deg is not None for match in best], dtype=bool)
    beside = [
        abs(match.lateral_m - left_of_m(matched[row], true[row]))
        for row, match in enumerate(best)
        if match.lateral_m is not None
    ]
    findable, recall_at_1 = recalls_within(recorded_m, answered.nearest_m, tolerances_m)
    took_ms = np.array([1e3 * answer.seconds for answer in given])
    return ConditionResult(
        condition=condition,
        queries=len(queries),
        refusals=len(queries) - len(answered),
        segment_accuracy=1.0 - len(errors) / checked if checked else None,
        errors=errors,
        errors_moving=None if standing is None else len(errors) - standing,
        errors_stationary=standing,
        errors_same_place=same_place,
        findable=findable,
        recall_at_1=recall_at_1,
        position_error_m_median=median(apart_m(estimated, true)),
        nearest_scan_m_median=median(nearest_place(tensor_map.trajectory.poses, true)[1]),
        heading_error_deg_median=median(
            heading_error_deg(heading_deg(estimated[has_heading]), heading_deg(true[has_heading]))
        ),
        lateral_error_m_median=median(np.array(beside)),
        ms_per_query=median(took_ms),
        ms_slowest=float(took_ms.max()) if given else None,
        reliability=_reliability(
            [answer.found for answer in given],
            elsewhere,
            apart_m(matched, true),
            answered.nearest_m <= max(tolerances_m),
        ),
    )


def _segment_errors(
    queries: LocatedQueries, best: Sequence[Match], recorded_m: FloatArray
) -> tuple[SegmentError, ...]:
    """Return the queries whose best match is in another segment than they are."""
    scans = scan_index_of(queries.drive)[queries.scans]
    return tuple(
        SegmentError(
            scan=int(scans[row]),
            matched_scan=match.scan_index,
            segment=int(queries.segment[row]),
            matched_segment=match.segment,
            apart_m=none_if_nan(float(metres)),
            standing=None if queries.standing is None else bool(queries.standing[row]),
            motion_surrogate=plain(float(queries.surrogate[row])),
        )
        for row, (match, metres) in enumerate(zip(best, recorded_m, strict=True))
        if 0 <= queries.segment[row] != match.segment
    )


def _reliability(
    found: Sequence[Localization],
    elsewhere: Sequence[Answer | None],
    matched_m: FloatArray,
    findable: BoolArray,
) -> Reliability | None:
    """Check probabilities; a match is right within `AWAY_M`, as it is when they are learned.

    Args:
        found: n answers.
        elsewhere: The answers to scans of places that are not in the map.
        matched_m: `(n,)` how far the vehicle was from the matched scan, NaN where unknown.
        findable: `(n,)` which queries are of places that the map has.
    """
    located, right = np.isfinite(matched_m), matched_m < AWAY_M
    known, off_map = (
        _outcomes([(found[row], bool(right[row])) for row in np.flatnonzero(rows).tolist()])
        for rows in (located & findable, located & ~findable)
    )
    if not known and not off_map:
        return None
    unknown = _outcomes([(a.found, False) for a in elsewhere if a is not None])
    return reliability(known, unknown, len(off_map))


def _outcomes(found: Sequence[tuple[Localization, bool]]) -> list[Outcome]:
    return [
        Outcome(localization.decision.probability, localization.localized, right)
        for localization, right in found
        if localization.decision.probability is not None
    ]
