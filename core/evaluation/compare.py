"""Run several methods of place recognition on the same scans, by the field's protocol."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from core.arrays import BoolArray, FloatArray, IntArray
from core.errors import InvalidParameters, InvalidScan
from core.evaluation.comparison import Comparison, MethodResult, MethodUnderCondition
from core.evaluation.condition import Condition
from core.evaluation.contestants import Contestant, Enrolled
from core.evaluation.pairing import HeldOut, Paired, Pairing
from core.evaluation.retrieval import auroc, precision_recall
from core.progress import NO_PROGRESS, Progress
from core.scans.angles import wrapped_deg
from core.scans.drive import Drive
from core.scans.pose import heading_deg, is_known
from core.scans.scan import Scan

__all__ = ["ComparisonProtocol", "compare"]


@dataclass(frozen=True)
class ComparisonProtocol:
    """How methods are compared.

    Attributes:
        pairing: Which scans are places, and which are queries.
        conditions: The disturbances of the queries.
        tolerances_m: Within which an answer is right, rising.
        unknown_every: Ask each so-manieth scan of the unknown drive.
        seed: Of the noise; a scan's noise is the same for all methods.
    """

    pairing: Pairing = field(default_factory=HeldOut)
    conditions: tuple[Condition, ...] = (Condition(),)
    tolerances_m: tuple[float, ...] = (3.0, 5.0, 10.0)
    unknown_every: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        if not self.tolerances_m or not all(0 < m < math.inf for m in self.tolerances_m):
            raise InvalidParameters(f"tolerances_m is {self.tolerances_m}, wanted metres above 0")
        if not self.conditions:
            raise InvalidParameters("conditions is empty, wanted at least one")
        if self.unknown_every < 1:
            raise InvalidParameters(f"unknown_every is {self.unknown_every}, wanted 1 or more")
        if self.seed < 0:
            raise InvalidParameters(f"seed is {self.seed}, wanted 0 or more")


@dataclass(frozen=True)
class _Answer:
    """What became of one query; `scan` is -1 without an answer."""

    scan: int = -1
    score: float = -math.inf
    turn_deg: float | None = None
    refused: bool = False
    describe_s: float = math.nan
    match_s: float = math.nan


def compare(
    drive: Drive,
    contestants: Sequence[Contestant],
    protocol: ComparisonProtocol,
    query_drive: Drive | None = None,
    unknown_drive: Drive | None = None,
    progress: Progress = NO_PROGRESS,
) -> Comparison:
    """Enrol the same scans with every method, and ask every method the same queries.

    Each query is read once, disturbed once for each condition, and given to the methods in turn.
    The score of an answer is its distance, negated.

    Args:
        drive: The places are scans of it.
        contestants: The methods.
        protocol: How.
        query_drive: Asked, in the same world frame; without one `drive` is.
        unknown_drive: Of places that are not in `drive`; its queries tell the novelty AUROC.
        progress: Told of each scan enrolled and each query.

    Raises:
        EmptyDrive: If a drive has no scan, or a method can use none of the places.
        InvalidParameters: If there is nothing to ask, nothing to ask with, a name comes twice, or
            poses are unknown.
    """
    names = [contestant.name for contestant in contestants]
    if not names or len(set(names)) < len(names):
        raise InvalidParameters(f"the methods are {names}, wanted one or more, each once")
    paired = protocol.pairing.pair(drive, query_drive)
    asked = drive if query_drive is None else query_drive
    for of, scans in ((drive, paired.places), (asked, paired.queries)):
        if not is_known(of.poses[scans]).all():
            raise InvalidParameters(
                f"drive {of.name} has scans without a pose: right and wrong cannot be told apart"
            )
    enrolled = [contestant.enrol(drive, paired.places, progress) for contestant in contestants]
    answers = _ask(
        asked, paired.queries, paired.first_excluded, enrolled, protocol, "asking", progress
    )
    unknown: list[list[list[_Answer]]] | None = None
    if unknown_drive is not None:
        scans = np.arange(0, len(unknown_drive), protocol.unknown_every)
        everything = np.full(len(scans), len(drive))
        unknown = _ask(
            unknown_drive, scans, everything, enrolled, protocol, "asking elsewhere", progress
        )
    truth = _Truth.of(drive, asked, paired, protocol.tolerances_m)
    return Comparison(
        drive=drive.name,
        query_drive=None if query_drive is None else query_drive.name,
        unknown_drive=None if unknown_drive is None else unknown_drive.name,
        protocol=str(protocol.pairing),
        scans=len(drive),
        seed=protocol.seed,
        methods=tuple(
            MethodResult(
                name=contestant.name,
                configuration=contestant.configuration(),
                places=len(of_it.scans),
                sent_bytes=of_it.sent_bytes,
                stored_bytes=of_it.stored_bytes,
                conditions=tuple(
                    _summarize(
                        condition,
                        answers[row][column],
                        None if unknown is None else unknown[row][column],
                        truth,
                    )
                    for column, condition in enumerate(protocol.conditions)
                ),
            )
            for row, (contestant, of_it) in enumerate(zip(contestants, enrolled, strict=True))
        ),
    )


def _ask(
    drive: Drive,
    scans: IntArray,
    first_excluded: IntArray,
    enrolled: Sequence[Enrolled],
    protocol: ComparisonProtocol,
    stage: str,
    progress: Progress,
) -> list[list[list[_Answer]]]:
    """Return the answers by method, condition and query."""
    answers: list[list[list[_Answer]]] = [[[] for _ in protocol.conditions] for _ in enrolled]
    progress.start(stage, len(scans) * len(protocol.conditions) * len(enrolled))
    for scan_index, last in zip(scans.tolist(), first_excluded.tolist(), strict=True):
        for column, condition in enumerate(protocol.conditions):
            rng = np.random.default_rng([protocol.seed, scan_index])
            try:
                scan = condition.apply(drive.scan(scan_index), rng)
            except InvalidScan:
                scan = None
            for of_it, row in zip(enrolled, answers, strict=True):
                row[column].append(
                    _Answer(refused=True) if scan is None else _answer(of_it, scan, last)
                )
                progress.advance()
    return answers


def _answer(enrolled: Enrolled, scan: Scan, first_excluded: int) -> _Answer:
    before = int(np.searchsorted(enrolled.scans, first_excluded))
    begun = time.process_time()  # not of the wall: other work on the machine must not count
    try:
        ask = enrolled.describe(scan)
    except InvalidScan:
        return _Answer(refused=True)
    described = time.process_time()
    found = ask(None if before == len(enrolled.scans) else before)
    matched = time.process_time()
    describe_s, match_s = described - begun, matched - described
    if found is None:
        return _Answer(describe_s=describe_s, match_s=match_s)
    return _Answer(
        int(enrolled.scans[found.row]),
        -found.distance,
        found.turn_deg,
        describe_s=describe_s,
        match_s=match_s,
    )


@dataclass(frozen=True, eq=False)
class _Truth:
    """What is true of the queries: poses, and how far the nearest place is."""

    places: FloatArray  # (scans of the drive, 7)
    queries: FloatArray  # (Q, 7)
    nearest_m: FloatArray  # (Q,)
    tolerances_m: tuple[float, ...]

    @classmethod
    def of(
        cls, drive: Drive, asked: Drive, paired: Paired, tolerances_m: tuple[float, ...]
    ) -> "_Truth":
        queries = asked.poses[paired.queries]
        place_m = drive.poses[paired.places, :3]
        nearest_m = np.array(
            [
                np.linalg.norm(place_m[paired.places < last] - at, axis=1).min(initial=math.inf)
                for at, last in zip(queries[:, :3], paired.first_excluded.tolist(), strict=True)
            ]
        )
        return cls(drive.poses, queries, nearest_m, tolerances_m)

    def distance_m(self, answered: IntArray) -> FloatArray:
        """Return how far each answer is from its query, infinite without one."""
        between = self.places[answered, :3] - self.queries[:, :3]
        return np.where(answered >= 0, np.linalg.norm(between, axis=1), math.inf)

    def turn_error_deg(self, answered: IntArray, told: FloatArray, yaw_deg: float) -> FloatArray:
        """Return the error of each answer's heading, NaN where none is told."""
        true = heading_deg(self.queries) + yaw_deg - heading_deg(self.places)[answered]
        return np.asarray(np.abs(wrapped_deg(told - true)))


def _summarize(
    condition: Condition,
    answers: Sequence[_Answer],
    unknown: Sequence[_Answer] | None,
    truth: _Truth,
) -> MethodUnderCondition:
    answered = np.array([answer.scan for answer in answers])
    scores = np.array([answer.score for answer in answers])
    distance_m = truth.distance_m(answered)
    findable, recall, f1, precision = {}, {}, {}, {}
    for metres in truth.tolerances_m:
        right = distance_m <= metres
        count = int((truth.nearest_m <= metres).sum())
        curve = precision_recall(scores, right, count)
        findable[metres] = count
        recall[metres] = float(right.sum() / count) if count else None
        f1[metres] = curve.max_f1 if count else None
        precision[metres] = curve.average_precision if count else None
    widest_m = max(truth.tolerances_m)
    told = np.array([math.nan if a.turn_deg is None else a.turn_deg for a in answers])
    error_deg = truth.turn_error_deg(answered, told, condition.yaw_deg)
    known: BoolArray = truth.nearest_m <= widest_m
    return MethodUnderCondition(
        condition=condition,
        queries=len(answers),
        refusals=sum(answer.refused for answer in answers),
        unanswered=sum(answer.scan < 0 and not answer.refused for answer in answers),
        findable=findable,
        recall_at_1=recall,
        max_f1=f1,
        average_precision=precision,
        novelty_auroc=None
        if unknown is None
        else auroc(scores[known], np.array([answer.score for answer in unknown])),
        heading_error_deg_median=_median(error_deg[distance_m <= widest_m]),
        describe_ms_median=_median(np.array([1e3 * answer.describe_s for answer in answers])),
        match_ms_median=_median(np.array([1e3 * answer.match_s for answer in answers])),
    )


def _median(values: FloatArray) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else None
