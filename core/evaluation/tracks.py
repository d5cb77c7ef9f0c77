"""The queries of an evaluation as one vehicle's drive: what tracking makes of them."""

import itertools
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from core.arrays import BoolArray, FloatArray, IntArray
from core.encodings.signature import Signature
from core.errors import InvalidScan
from core.evaluation.condition import Condition
from core.localization.localizer import Localizer
from core.progress import NO_PROGRESS, Progress
from core.scans.drive import Drive
from core.tracking.step import TrackStep
from core.tracking.track import Observation, Track, Tracker

__all__ = ["Asked", "TrackError", "TrackResult", "cut_position", "evaluate_tracks", "track_drive"]

_KIDNAPPINGS = 8  # spread over the drive
_BEFORE, _AFTER = 10, 30  # queries before a vehicle is carried off, and within which it is found
_RIGHT_M = 10.0


@dataclass(frozen=True, eq=False)
class Asked:
    """The scans that are asked, in order, and what is true of them.

    Attributes:
        drive: Where they are from.
        scans: `(n,)` their positions in it.
        segment: `(n,)` where they belong, -1 where no pose tells it.
        standing: `(n,)` whether the vehicle stood, `None` without poses.
    """

    drive: Drive
    scans: IntArray
    segment: IntArray
    standing: BoolArray | None


@dataclass(frozen=True)
class TrackError:
    """An observation that was put on a wrong segment.

    Attributes:
        observation: Which one, from 0.
        scan: Its index in its drive.
        segment: Where it belongs.
        told_segment: Where it was put.
        told_scan: Index of the map scan nearest to that place.
        probability: Of the segment, as it was told.
        standing: Whether the vehicle stood, `None` without poses.
    """

    observation: int
    scan: int
    segment: int
    told_segment: int
    told_scan: int
    probability: float
    standing: bool | None


@dataclass(frozen=True)
class TrackResult:
    """One drive under one condition, tracked; what does not apply is `None`.

    Attributes:
        condition: The disturbance.
        observations: How many were taken.
        refusals: How many scans gave none.
        localized: For how many a place was told; recall and error are of these.
        not_localized: Why none was told, how often.
        first_fix: How many observations it took until a place was told.
        errors: Wrong segments that were told.
        errors_moving: How many of them while the vehicle moved.
        errors_stationary: How many while it stood.
        segments_told: How many segments were told: a place was, and its segment is sure, 0.9.
        unsure_wrong: How many were not told because two were likely, and the likelier was wrong.
        recall_at_1: Share whose map scan was recorded within so many metres.
        position_error_m_median: Median distance of the estimated position.
        standing_found: Share of the standing vehicle's observations that were told as such.
        standing_false: Share of the moving vehicle's that were told as standing.
        flicker: Changes of the told segment while the vehicle stood, beyond those that are true.
        scan_changes: Changes of the told scan from one observation told as standing to the next.
        recovery: How many observations each kidnapping took until the place was right again,
            `None` for one that was not found within 30.
        ms_per_observation: Mean wall time from signatures to answer.
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
    segments_told: int
    unsure_wrong: int
    recall_at_1: dict[float, float | None]
    position_error_m_median: float | None
    standing_found: float | None
    standing_false: float | None
    flicker: int | None
    scan_changes: int
    recovery: tuple[int | None, ...]
    ms_per_observation: float | None

    def as_dict(self) -> dict[str, Any]:
        """Return plain values, `errors` as their number."""
        return {
            **asdict(self),
            "condition": asdict(self.condition),
            "errors": len(self.errors),
            "error_scans": [asdict(error) for error in self.errors],
            "recall_at_1": {f"{metres:g}": share for metres, share in self.recall_at_1.items()},
            "recovery": list(self.recovery),
        }


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
    asked: Asked,
    conditions: Sequence[Condition],
    tolerances_m: Sequence[float],
    seed: int,
    progress: Progress = NO_PROGRESS,
) -> tuple[TrackResult, ...]:
    """Track the queries under each condition."""
    progress.start("tracking", len(asked.scans) * len(conditions))
    results = []
    for condition in conditions:
        kept, observations = _observations(tracker.localizer, asked, condition, seed, progress)
        part = Asked(
            asked.drive,
            asked.scans[kept],
            asked.segment[kept],
            None if asked.standing is None else asked.standing[kept],
        )
        results.append(
            track_drive(
                tracker, part, observations, condition, tolerances_m, len(asked.scans) - len(kept)
            )
        )
    return tuple(results)


def _observations(
    localizer: Localizer, asked: Asked, condition: Condition, seed: int, progress: Progress
) -> tuple[list[int], list[Observation]]:
    kept, observations = [], []
    for index, scan_index in enumerate(asked.scans.tolist()):
        progress.advance()
        try:
            scan = condition.apply(
                asked.drive.scan(scan_index), np.random.default_rng([seed, scan_index])
            )
            signatures: tuple[Signature, ...] = localizer.basis.encode(localizer.basis.image(scan))
        except InvalidScan:
            continue
        kept.append(index)
        observations.append(Observation(signatures))
    return kept, observations


def track_drive(
    tracker: Tracker,
    asked: Asked,
    observations: Sequence[Observation],
    condition: Condition,
    tolerances_m: Sequence[float],
    refusals: int = 0,
) -> TrackResult:
    """Track observations of `asked`, one a scan of it."""
    track = Track(tracker)
    begun = time.perf_counter()
    steps = [track.observe(observation) for observation in observations]
    seconds = time.perf_counter() - begun
    localized = np.array([step.localized for step in steps], dtype=bool)
    wrong = _wrong(tracker, asked, steps)
    errors = tuple(error for error in wrong if steps[error.observation].segment_sure)
    standing = asked.standing
    told_standing = np.array([step.standing for step in steps], dtype=bool)
    true = [condition.pose(asked.drive.poses[scan]) for scan in asked.scans.tolist()]
    recorded_m = _apart_m(
        [tracker.map.trajectory.poses[step.row] for step in steps],
        [asked.drive.poses[scan] for scan in asked.scans.tolist()],
    )[localized]
    displaced_m = _apart_m(
        [np.full(7, np.nan) if s.pose is None else np.array(s.pose.as_tuple()) for s in steps],
        true,
    )[localized]
    stationary = None if standing is None else sum(bool(error.standing) for error in errors)
    return TrackResult(
        condition=condition,
        observations=len(steps),
        refusals=refusals,
        localized=int(localized.sum()),
        not_localized=dict(
            sorted(Counter(s.reason.value for s in steps if s.reason is not None).items())
        ),
        first_fix=int(localized.argmax()) + 1 if localized.any() else None,
        errors=errors,
        errors_moving=None if stationary is None else len(errors) - stationary,
        errors_stationary=stationary,
        segments_told=sum(step.segment_sure for step in steps),
        unsure_wrong=len(wrong) - len(errors),
        recall_at_1={metres: _share(recorded_m <= metres, recorded_m) for metres in tolerances_m},
        position_error_m_median=_median(displaced_m),
        standing_found=None if standing is None else _rate(told_standing[standing]),
        standing_false=None if standing is None else _rate(told_standing[~standing]),
        flicker=_flicker(steps, asked),
        scan_changes=sum(
            one.standing and two.standing and one.row != two.row
            for one, two in itertools.pairwise(steps)
        ),
        recovery=_recovery(tracker, asked, observations),
        ms_per_observation=1e3 * seconds / len(steps) if steps else None,
    )


def _wrong(tracker: Tracker, asked: Asked, steps: Sequence[TrackStep]) -> tuple[TrackError, ...]:
    return tuple(
        TrackError(
            observation=index,
            scan=int(asked.scans[index]),
            segment=int(asked.segment[index]),
            told_segment=step.segment,
            told_scan=int(tracker.map.trajectory.scan_index[step.row]),
            probability=step.segment_probability,
            standing=None if asked.standing is None else bool(asked.standing[index]),
        )
        for index, step in enumerate(steps)
        if step.localized and asked.segment[index] >= 0 and step.segment != asked.segment[index]
    )


def _flicker(steps: Sequence[TrackStep], asked: Asked) -> int | None:
    if asked.standing is None:
        return None
    told = true = 0
    for index in range(1, len(steps)):
        if asked.standing[index - 1 : index + 1].all() and steps[index - 1].localized:
            told += steps[index].segment != steps[index - 1].segment
            true += bool(asked.segment[index] != asked.segment[index - 1])
    return max(0, told - true)


def _recovery(
    tracker: Tracker, asked: Asked, observations: Sequence[Observation]
) -> tuple[int | None, ...]:
    """Carry the vehicle off to half a drive away, several times."""
    count = len(observations)
    if count < 2 * (_BEFORE + _AFTER):
        return ()
    poses = asked.drive.poses[asked.scans]
    found: list[int | None] = []
    for start in np.linspace(0, count // 2 - _AFTER, _KIDNAPPINGS).astype(int).tolist():
        track = Track(tracker)
        for observation in observations[start : start + _BEFORE]:
            track.observe(observation)
        there = start + count // 2
        found.append(None)
        for index in range(there, there + _AFTER):
            step = track.observe(observations[index])
            if step.localized and _is_right(tracker, step, poses[index], asked.segment[index]):
                found[-1] = index - there + 1
                break
    return tuple(found)


def _is_right(tracker: Tracker, step: TrackStep, pose: FloatArray, segment: int) -> bool:
    apart_m = float(_apart_m([tracker.map.trajectory.poses[step.row]], [pose])[0])
    return step.segment == segment if np.isnan(apart_m) else apart_m <= _RIGHT_M


def _apart_m(found: Sequence[FloatArray], true: Sequence[FloatArray]) -> FloatArray:
    """Return how far apart poses are, `(n,)` metres, NaN where one is unknown."""
    if not found:
        return np.empty(0)
    return np.asarray(np.linalg.norm(np.stack(found)[:, :3] - np.stack(true)[:, :3], axis=1))


def _share(right: BoolArray, values: FloatArray) -> float | None:
    known = np.isfinite(values)
    return float(right[known].mean()) if known.any() else None


def _rate(told: BoolArray) -> float | None:
    return float(told.mean()) if len(told) else None


def _median(values: FloatArray) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else None
