"""The queries of an evaluation, tracked as one vehicle's drive."""

import itertools
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from core.arrays import FloatArray, IntArray
from core.evaluation.condition import Condition
from core.evaluation.metrics import apart_m, median, rate
from core.evaluation.nearest import recalls_within
from core.evaluation.plain import Plain
from core.evaluation.query_set import LocatedQueries
from core.progress import NO_PROGRESS, Progress
from core.scans.drive import scan_index_of
from core.scans.pose import pose_rows
from core.scans.scan import Scan
from core.tracking.step import TrackStep
from core.tracking.track import Observation, Track, Tracker

_KIDNAPPINGS = 8  # spread over the drive
_BEFORE, _AFTER = 10, 30  # queries before a kidnapping, and within which the vehicle is found
_RIGHT_M = 10.0


@dataclass(frozen=True)
class TrackError:
    """An observation that was matched on a segment that is not of its place.

    Attributes:
        observation: Which one, from 0.
        scan: The scan's index in its drive.
        segment: The true one.
        reported_segment: The reported one.
        reported_scan: Index of the map scan nearest to the reported place.
        probability: The probability of the reported segment.
        standing: Whether the vehicle was stationary, `None` without poses.
    """

    observation: int
    scan: int
    segment: int
    reported_segment: int
    reported_scan: int
    probability: float
    standing: bool | None


@dataclass(frozen=True)
class TrackResult(Plain):
    """One drive under one condition, tracked; `None` where not applicable.

    Attributes:
        condition: The disturbance.
        observations: How many were taken.
        refusals: How many scans gave none.
        localized: How many gave a place; recall and error are of these.
        not_localized: Why there was none, how often.
        first_fix: How many observations it took until the first place.
        errors: Wrong segments that were given as sure.
        errors_moving: How many of them while the vehicle moved.
        errors_stationary: How many while it was stationary.
        segments_reported: How many gave a place whose segment is sure, 0.9.
        unsure_wrong: How many gave none because two were likely, and the likelier was wrong.
        findable: How many of those with a place had a map scan recorded within so many metres.
        recall_at_1: Share of these whose given map scan was.
        position_error_m_median: Median distance of the estimated position.
        standing_found: Share of the observations while stationary that were found stationary.
        standing_false: Share of the observations while moving that were found stationary.
        flicker: Changes of the segment while the vehicle was stationary, beyond the true ones.
        scan_changes: Changes of the scan from one observation found stationary to the next.
        recovery: How many observations each kidnapping took until the place was right again,
            `None` for one that was not found within 30.
        ms_per_observation: Median wall time from signatures to answer.
        ms_slowest: The longest, which holds what the first observation alone prepares.
    """

    condition: Condition
    observations: int
    refusals: int
    localized: int
    not_localized: dict[str, int]
    first_fix: int | None
    errors: tuple[TrackError, ...]
    errors_moving: int | None
    errors_stationary: int | None
    segments_reported: int
    unsure_wrong: int
    findable: dict[float, int]
    recall_at_1: dict[float, float | None]
    position_error_m_median: float | None
    standing_found: float | None
    standing_false: float | None
    flicker: int | None
    scan_changes: int
    recovery: tuple[int | None, ...]
    ms_per_observation: float | None
    ms_slowest: float | None

    @property
    def recovery_text(self) -> str:
        """The longest recovery, and how many kidnappings were not recovered from."""
        if not self.recovery:
            return "-"
        known = [scans for scans in self.recovery if scans is not None]
        lost = len(self.recovery) - len(known)
        return f"{max(known, default='-')}" + (f", {lost} lost" if lost else "")

    def as_dict(self) -> dict[str, Any]:
        """Return plain values, `errors` as their number."""
        found = super().as_dict()
        return {**found, "errors": len(self.errors), "error_scans": found["errors"]}


def cut_position(mapped: IntArray, segment_start: IntArray) -> FloatArray:
    """Return where a drive was cut, in rows of a map that holds only some of its scans, `(L + 1,)`.

    The scans on either side of a cut may have been held out; the map then cannot tell where
    between its own scans a segment ends. The evaluation, which cut the drive before it was split,
    can: half-way between the drive's scans on either side.

    Args:
        mapped: `(K,)` which scans of the drive the map holds, rising.
        segment_start: `(L + 1,)` the drive's cuts.

    Examples:
        >>> cut_position(np.array([0, 1, 2, 4, 5]), np.array([0, 3, 6])).tolist()
        [-0.5, 2.25, 4.5]
    """
    inner = segment_start[1:-1] - 0.5
    within = np.interp(inner, mapped, np.arange(len(mapped)))
    return np.concatenate([[-0.5], within, [len(mapped) - 0.5]])


def evaluate_tracks(
    tracker: Tracker,
    queries: LocatedQueries,
    tolerances_m: Sequence[float],
    progress: Progress = NO_PROGRESS,
) -> tuple[TrackResult, ...]:
    """Track the queries under each condition."""
    basis = tracker.localizer.basis

    def observe(_: int, scan: Scan) -> Observation:
        image = basis.image(scan)
        return Observation(basis.encode(image), image=image)

    (observed,) = queries.answers([observe], "tracking", progress)
    return tuple(
        _tracked(tracker, queries, condition, of_condition, tolerances_m)
        for condition, of_condition in zip(queries.conditions, observed, strict=True)
    )


def _tracked(
    tracker: Tracker,
    queries: LocatedQueries,
    condition: Condition,
    observed: Sequence[Observation | None],
    tolerances_m: Sequence[float],
) -> TrackResult:
    used, observations = queries.answered(observed)
    track = Track(tracker)
    steps, ended = [], [time.perf_counter()]
    for observation in observations:
        steps.append(track.observe(observation))
        ended.append(time.perf_counter())
    took_ms = 1e3 * np.diff(ended)
    localized = np.array([step.localized for step in steps], dtype=bool)
    wrong = _wrong(tracker, used, steps)
    errors = tuple(error for error in wrong if steps[error.observation].segment_sure)
    standing = used.standing
    found_standing = np.array([step.stationary for step in steps], dtype=bool)
    true = np.array([condition.pose(pose) for pose in used.poses]).reshape(-1, 7)
    matched = tracker.map.trajectory.poses[np.array([step.row for step in steps], np.int64)]
    estimated = pose_rows([step.pose for step in steps])
    recorded_m = apart_m(matched, used.poses)[localized]
    findable, recall_at_1 = recalls_within(recorded_m, used.nearest_m[localized], tolerances_m)
    stationary = None if standing is None else sum(bool(error.standing) for error in errors)
    return TrackResult(
        condition=condition,
        observations=len(steps),
        refusals=len(queries) - len(used),
        localized=int(localized.sum()),
        not_localized=dict(sorted(Counter(s.reason.value for s in steps if s.reason).items())),
        first_fix=int(localized.argmax()) + 1 if localized.any() else None,
        errors=errors,
        errors_moving=None if stationary is None else len(errors) - stationary,
        errors_stationary=stationary,
        segments_reported=sum(step.segment_sure for step in steps),
        unsure_wrong=len(wrong) - len(errors),
        findable=findable,
        recall_at_1=recall_at_1,
        position_error_m_median=median(apart_m(estimated, true)[localized]),
        standing_found=None if standing is None else rate(found_standing[standing]),
        standing_false=None if standing is None else rate(found_standing[~standing]),
        flicker=_flicker(steps, used),
        scan_changes=sum(
            one.stationary and two.stationary and one.row != two.row
            for one, two in itertools.pairwise(steps)
        ),
        recovery=_recovery(tracker, used, observations),
        ms_per_observation=median(took_ms),
        ms_slowest=float(took_ms.max()) if steps else None,
    )


def _wrong(
    tracker: Tracker, queries: LocatedQueries, steps: Sequence[TrackStep]
) -> tuple[TrackError, ...]:
    scans, there = scan_index_of(queries.drive)[queries.scans], queries.segments_there
    return tuple(
        TrackError(
            observation=index,
            scan=int(scans[index]),
            segment=int(queries.segment[index]),
            reported_segment=step.segment,
            reported_scan=int(tracker.map.trajectory.scan_index[step.row]),
            probability=step.segment_probability,
            standing=None if queries.standing is None else bool(queries.standing[index]),
        )
        for index, step in enumerate(steps)
        if step.localized and queries.segment[index] >= 0 and not _is_there(step, there[index])
    )


def _flicker(steps: Sequence[TrackStep], queries: LocatedQueries) -> int | None:
    if queries.standing is None:
        return None
    reported = true = 0
    last = queries.segments_there[:, 1]
    for index in range(1, len(steps)):
        if queries.standing[index - 1 : index + 1].all() and steps[index - 1].localized:
            reported += steps[index].segment != steps[index - 1].segment
            true += bool(last[index] != last[index - 1])
    return max(0, reported - true)


def _recovery(
    tracker: Tracker, queries: LocatedQueries, observations: Sequence[Observation]
) -> tuple[int | None, ...]:
    """Kidnap the vehicle to half a drive away, several times."""
    count = len(observations)
    if count < 2 * (_BEFORE + _AFTER):
        return ()
    # Images only make poses more exact, which are not looked at here.
    observations = [replace(observation, image=None) for observation in observations]
    poses, segments = queries.poses, queries.segments_there
    found: list[int | None] = []
    for start in np.linspace(0, count // 2 - _AFTER, _KIDNAPPINGS).astype(int).tolist():
        track = Track(tracker)
        for observation in observations[start : start + _BEFORE]:
            track.observe(observation)
        there = start + count // 2
        found.append(None)
        for index in range(there, there + _AFTER):
            step = track.observe(observations[index])
            if step.localized and _is_right(tracker, step, poses[index], segments[index]):
                found[-1] = index - there + 1
                break
    return tuple(found)


def _is_right(tracker: Tracker, step: TrackStep, pose: FloatArray, there: IntArray) -> bool:
    distance_m = float(apart_m(tracker.map.trajectory.poses[step.row], pose))
    return _is_there(step, there) if np.isnan(distance_m) else distance_m <= _RIGHT_M


def _is_there(step: TrackStep, there: IntArray) -> bool:
    """Return whether a reported segment is one of the query's place."""
    first, last = there.tolist()
    return bool(first <= step.segment <= last)
