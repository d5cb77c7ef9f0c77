"""What the answers under one condition come to."""

from collections.abc import Sequence

import numpy as np

from core.arrays import FloatArray
from core.confidence.places import AWAY_M
from core.evaluation.condition import Condition
from core.evaluation.queries import Answer, Queries
from core.evaluation.reliability import Judged, Reliability, reliability
from core.evaluation.result import ConditionResult, SegmentError
from core.localization.localizer import Localization
from core.scans.angles import wrapped_deg
from core.scans.displacement import left_of_m
from core.scans.pose import heading_deg

__all__ = ["summarize"]


def summarize(
    condition: Condition,
    answers: Sequence[Answer],
    elsewhere: Sequence[Localization],
    queries: Queries,
    tolerances_m: Sequence[float],
) -> ConditionResult:
    """Sum up what a map answered under one condition.

    Args:
        condition: The disturbance.
        answers: To the queries, those that were refused left out.
        elsewhere: To scans of places that are not in the map.
        queries: All that were asked.
        tolerances_m: Within which a match counts as recalled.
    """
    row_of = {scan: row for row, scan in enumerate(queries.scans.tolist())}
    judged = [a for a in answers if a.segment >= 0]
    wrong = [a for a in judged if a.matched_segment != a.segment]
    errors = tuple(_segment_error(a, queries, row_of[a.scan]) for a in wrong)
    tells = queries.standing is not None and bool(judged)
    standing = sum(bool(e.standing) for e in errors) if tells else None
    poses = queries.drive.poses
    true = [condition.pose(poses[a.scan]) for a in answers]
    recorded_m = _distances_m([a.matched for a in answers], [poses[a.scan] for a in answers])
    displaced_m = _distances_m([a.estimated for a in answers], true)
    turned = [
        _heading_error_deg(a.estimated, pose)
        for a, pose in zip(answers, true, strict=True)
        if a.heading_told
    ]
    beside = [
        abs(a.lateral_m - left_of_m(a.matched, pose))
        for a, pose in zip(answers, true, strict=True)
        if a.lateral_m is not None
    ]
    return ConditionResult(
        condition=condition,
        queries=len(queries.scans),
        refusals=len(queries.scans) - len(answers),
        segment_accuracy=1.0 - len(wrong) / len(judged) if judged else None,
        errors=errors,
        errors_moving=None if standing is None else len(errors) - standing,
        errors_stationary=standing,
        recall_at_1={
            metres: float(np.mean(recorded_m <= metres)) if len(recorded_m) else None
            for metres in tolerances_m
        },
        position_error_m_median=_median(displaced_m),
        heading_error_deg_median=_median(np.array(turned)),
        lateral_error_m_median=_median(np.array(beside)),
        reliability=_reliability(answers, elsewhere, true),
        ms_per_query=1e3 * float(np.mean([a.seconds for a in answers])) if answers else None,
    )


def _reliability(
    answers: Sequence[Answer], elsewhere: Sequence[Localization], true: Sequence[FloatArray]
) -> Reliability | None:
    """Judge probabilities; a match is right within `AWAY_M`, as it is when they are learned."""
    known = [
        Judged(
            answer.probability,
            answer.localized,
            bool(np.linalg.norm(answer.matched[:3] - pose[:3]) < AWAY_M),
        )
        for answer, pose in zip(answers, true, strict=True)
        if answer.probability is not None
        and np.isfinite(answer.matched).all()
        and np.isfinite(pose).all()
    ]
    if not known:
        return None
    unknown = [
        Judged(found.verdict.probability, found.localized, right=False)
        for found in elsewhere
        if found.verdict.probability is not None
    ]
    return reliability(known, unknown)


def _segment_error(answer: Answer, queries: Queries, row: int) -> SegmentError:
    surrogate = float(queries.surrogate[row])
    return SegmentError(
        scan=answer.scan,
        matched_scan=answer.matched_scan,
        segment=answer.segment,
        matched_segment=answer.matched_segment,
        standing=None if queries.standing is None else bool(queries.standing[row]),
        motion_surrogate=None if np.isnan(surrogate) else surrogate,
    )


def _distances_m(found: Sequence[FloatArray], true: Sequence[FloatArray]) -> FloatArray:
    """Return how far the found poses are from the true ones, where both are known."""
    if not found:
        return np.empty(0)
    distances = np.linalg.norm(np.stack(found)[:, :3] - np.stack(true)[:, :3], axis=1)
    return np.asarray(distances[np.isfinite(distances)])


def _heading_error_deg(estimated: FloatArray, true: FloatArray) -> float:
    found, wanted = heading_deg(np.stack([estimated, true])).tolist()
    return abs(wrapped_deg(float(found - wanted)))


def _median(values: FloatArray) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else None
