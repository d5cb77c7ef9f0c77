"""The engine of every evaluation: a query set, disturbed and answered, one scan after another."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self, TypeVar

import numpy as np

from core.arrays import BoolArray, FloatArray, IntArray
from core.errors import EmptyDrive, InvalidParameters, InvalidScan
from core.evaluation.condition import Condition
from core.evaluation.disturbances import KITTI_RECORDING, Recording
from core.evaluation.motion import is_standing, motion_surrogate
from core.evaluation.selected import as_recorded
from core.evaluation.split import Split
from core.numbers import require_at_least
from core.progress import NO_PROGRESS, Progress
from core.scans.drive import Drive
from core.scans.mounting import MountedDrive
from core.scans.pose import is_known
from core.scans.scan import Scan

_Answer = TypeVar("_Answer")


@dataclass(frozen=True, kw_only=True)
class QueryProtocol:
    """The protocol of every evaluation: how queries are disturbed, and which answers are right.

    Attributes:
        conditions: The disturbances of the queries.
        tolerances_m: Within which an answer is right.
        seed: The seed of noise and disturbances; a scan's do not depend on the other queries.
    """

    conditions: tuple[Condition, ...] = (Condition(),)
    tolerances_m: tuple[float, ...] = (3.0, 5.0, 10.0)
    seed: int = 0

    def __post_init__(self) -> None:
        if not self.tolerances_m or not all(0 < m < math.inf for m in self.tolerances_m):
            raise InvalidParameters(f"tolerances_m is {self.tolerances_m}, wanted metres above 0")
        require_at_least(0, seed=self.seed)
        if not self.conditions:
            raise InvalidParameters("conditions is empty, wanted at least one")


@dataclass(frozen=True, eq=False)
class QuerySet:
    """Scans of a drive that are queried under every condition.

    Attributes:
        drive: The drive of the scans.
        scans: `(n,)` their positions in it.
        conditions: The disturbances.
        seed: The seed of noise and disturbances.
        recording: The sensor that recorded the scans.
    """

    drive: Drive
    scans: IntArray
    conditions: tuple[Condition, ...]
    seed: int
    recording: Recording = field(default=KITTI_RECORDING, kw_only=True)

    def __len__(self) -> int:
        return len(self.scans)

    def answers(
        self,
        methods: Sequence[Callable[[int, Scan], _Answer]],
        stage: str,
        progress: Progress = NO_PROGRESS,
    ) -> list[list[list[_Answer | None]]]:
        """Return the answers by method, condition and query.

        Each scan is read once, disturbed once for each condition, and passed to each method. The
        answer is `None` for a scan that cannot be used or that a method rejects with `InvalidScan`.

        Args:
            methods: Called with the query's number, 0-based, and its disturbed scan.
            stage: The name of the work, for progress.
            progress: Receives every answer.
        """
        found: list[list[list[_Answer | None]]] = [[[] for _ in self.conditions] for _ in methods]
        progress.start(stage, len(self) * len(self.conditions) * len(methods))
        for query, position in enumerate(self.scans.tolist()):
            for column, scan in enumerate(self._disturbed(position)):
                for method, answered in zip(methods, found, strict=True):
                    answered[column].append(None if scan is None else _answer(method, query, scan))
                    progress.advance()
        return found

    def _disturbed(self, position: int) -> Iterator[Scan | None]:
        try:
            scan = self.drive.scan(position)
        except InvalidScan:
            yield from [None] * len(self.conditions)
            return
        recorded, _ = as_recorded(self.drive, self.scans)
        mounting = recorded.mounting if isinstance(recorded, MountedDrive) else None
        recording = replace(self.recording, mounting=mounting)
        for condition in self.conditions:
            try:
                rng = np.random.default_rng([self.seed, position])
                yield condition.apply(scan, rng, recording)
            except InvalidScan:
                yield None


@dataclass(frozen=True, eq=False)
class LocatedQueries(QuerySet):
    """Queries with their ground truth.

    Attributes:
        segment: `(n,)` the true segments, -1 where there is none: a pose is unknown, or no scan of
            the map is near.
        segments_there: `(n, 2)` first and last of the segments of the query's place: several where
            a vehicle stood while they were cut, see `stands_of`.
        nearest_m: `(n,)` how far the nearest scan of the map was recorded, NaN where unknown.
    """

    segment: IntArray
    segments_there: IntArray
    nearest_m: FloatArray

    @cached_property
    def standing(self) -> BoolArray | None:
        """`(n,)` whether the vehicle is stationary, `None` without poses.

        A query whose pose is unknown, or that of the scan recorded before it, counts as moving.
        """
        recorded, scans = as_recorded(self.drive, self.scans)
        if not is_known(recorded.poses).any():
            return None
        return is_standing(recorded.poses, recorded.timestamp_s)[scans]

    @cached_property
    def surrogate(self) -> FloatArray:
        """`(n,)` the paper's norm of the 6-DOF change since the scan recorded before."""
        recorded, scans = as_recorded(self.drive, self.scans)
        return motion_surrogate(recorded.poses)[scans]

    @property
    def poses(self) -> FloatArray:
        """`(n, 7)` where they were recorded, NaN where unknown."""
        return np.asarray(self.drive.poses[self.scans])

    def answered(self, answers: Sequence[_Answer | None]) -> tuple[Self, list[_Answer]]:
        """Return the queries that were answered, and their answers.

        Args:
            answers: n, `None` where a query was rejected.
        """
        rows = np.array([row for row, one in enumerate(answers) if one is not None], np.int64)
        queries = replace(
            self,
            scans=self.scans[rows],
            segment=self.segment[rows],
            segments_there=self.segments_there[rows],
            nearest_m=self.nearest_m[rows],
        )
        return queries, [one for one in answers if one is not None]


def _answer(method: Callable[[int, Scan], _Answer], query: int, scan: Scan) -> _Answer | None:
    try:
        return method(query, scan)
    except InvalidScan:
        return None


def hold_out(split: Split, segment_start: IntArray) -> BoolArray:
    """Return which scans of a drive are queries, `(K,)`; the others are mapped.

    Raises:
        InvalidParameters: If none is, or all are.
    """
    held_out = split.held_out(segment_start)
    if held_out.all() or not held_out.any():
        scans, segments = len(held_out), len(segment_start) - 1
        found = f"{split} holds {held_out.sum()} of {scans} scans out"
        whole = split.held_out(np.array([0, scans]))
        if segments > 1 and whole.any() and not whole.all():
            # The first scan that differs from those before it is as far into any segment.
            least = int((whole != whole[0]).argmax()) + 1
            raise InvalidParameters(
                f"{found}, of {segments} segments with up to {np.diff(segment_start).max()} scans:"
                f" wanted segments of {least} scans or more, at most {scans // least} of them"
            )
        raise InvalidParameters(f"{found}: some must be queried, some mapped")
    return held_out


def require_scans(*drives: Drive) -> None:
    """Reject drives without a scan.

    Raises:
        EmptyDrive: If one has none.
    """
    for drive in drives:
        if len(drive) == 0:
            raise EmptyDrive(f"drive {drive.name} has no scan")
