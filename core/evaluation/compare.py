"""Run several methods of place recognition on the same scans, by the field's protocol."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from core.arrays import FloatArray, IntArray
from core.errors import InvalidParameters
from core.evaluation.condition import Condition
from core.evaluation.disturbances import KITTI_RECORDING, Recording
from core.evaluation.methods import Enrolled, Method
from core.evaluation.metrics import apart_m, heading_error_deg, median
from core.evaluation.nearest import nearest_place
from core.evaluation.pairing import HeldOut, Paired, Pairing
from core.evaluation.plain import Plain
from core.evaluation.query_set import QueryProtocol, QuerySet
from core.evaluation.retrieval import Counting, auroc, precision_recall
from core.numbers import nan_if_none, require_at_least
from core.progress import NO_PROGRESS, Progress
from core.scans.drive import Drive
from core.scans.pose import heading_deg, is_known
from core.scans.scan import Scan


@dataclass(frozen=True)
class ComparisonProtocol(QueryProtocol):
    """How methods are compared.

    Attributes:
        pairing: Which scans are places, and which are queries.
        unknown_every: Query with every N-th scan of the unknown drive.
        recording: The sensor that recorded the queries.
        counting: How precision and recall count.
    """

    pairing: Pairing = field(default_factory=HeldOut)
    unknown_every: int = 1
    recording: Recording = KITTI_RECORDING
    counting: Counting = field(default_factory=Counting)

    def __post_init__(self) -> None:
        super().__post_init__()
        require_at_least(1, unknown_every=self.unknown_every)


@dataclass(frozen=True)
class MethodUnderCondition(Plain):
    """One method, all queries under one condition; `None` where not applicable.

    Distances in metres are the keys of mappings: a query is *findable* within so many metres if a
    place that it may be compared with was recorded so near, and an answer is right if the place it
    names was. Near is of the place where the query was recorded, also under a lateral offset.

    Attributes:
        condition: The disturbance.
        queries: How many scans were queried.
        refusals: How many could not be described; like queries without an answer they are wrong.
        unanswered: How many were described and got no answer.
        findable: How many had something to find.
        recall_at_1: Share of findable queries whose answer is right.
        max_f1: Greatest F1 over all thresholds of the score.
        average_precision: Area under precision over recall, as a sum of steps.
        novelty_auroc: Probability that a findable query (within the greatest distance) scores above
            a query of the unknown drive.
        heading_error_deg_median: Over right answers (within the greatest distance) that have one.
        describe_ms_median: Processor time from returns to descriptor.
        match_ms_median: Processor time from descriptor to answer.
    """

    condition: Condition
    queries: int
    refusals: int
    unanswered: int
    findable: dict[float, int]
    recall_at_1: dict[float, float | None]
    max_f1: dict[float, float | None]
    average_precision: dict[float, float | None]
    novelty_auroc: float | None
    heading_error_deg_median: float | None
    describe_ms_median: float | None
    match_ms_median: float | None

    def as_dict(self) -> dict[str, Any]:
        """Return plain values."""
        found = super().as_dict()
        return {**found.pop("condition"), **found}


@dataclass(frozen=True)
class MethodResult(Plain):
    """One method.

    Attributes:
        name: The method's name.
        configuration: All its parameters.
        places: How many scans it keeps as places.
        sent_bytes: Size of a query as a vehicle sends it; `None` where it is not fixed.
        stored_bytes: Size of a stored place; `None` where it is unknown.
        conditions: The figures, one entry a disturbance.
    """

    name: str
    configuration: dict[str, Any]
    places: int
    sent_bytes: float | None
    stored_bytes: float | None
    conditions: tuple[MethodUnderCondition, ...]


@dataclass(frozen=True)
class Comparison(Plain):
    """The results of several methods on the same scans.

    Attributes:
        drive: Name of the drive that the places are of.
        query_drive: Name of the drive that the queries are of, `None` if it was the same.
        unknown_drive: Name of the drive of other places, `None` without one.
        protocol: How places and queries were chosen, in words.
        scans: How many scans the drive has.
        seed: The noise's seed.
        methods: The figures.
    """

    drive: str
    query_drive: str | None
    unknown_drive: str | None
    protocol: str
    scans: int
    seed: int
    methods: tuple[MethodResult, ...]


@dataclass(frozen=True)
class _Answer:
    """The answer of a method; `scan` is -1 where it described the query and found no place."""

    scan: int = -1
    score: float = -math.inf
    relative_yaw_deg: float = math.nan
    describe_s: float = math.nan
    match_s: float = math.nan


_REFUSED = _Answer()


def compare(
    drive: Drive,
    methods: Sequence[Method],
    protocol: ComparisonProtocol,
    query_drive: Drive | None = None,
    unknown_drive: Drive | None = None,
    progress: Progress = NO_PROGRESS,
) -> Comparison:
    """Enrol the same scans with every method, and query every method with the same scans.

    The score of an answer is its distance, negated. Scans without a pose are left out.

    Args:
        drive: The places are scans of it.
        methods: The methods to compare.
        protocol: How they are compared.
        query_drive: The drive whose scans are the queries, in the same world frame; without one
            `drive`'s are.
        unknown_drive: A drive through places that are not in `drive`, for the novelty AUROC.
        progress: Receives each scan enrolled and each answer.

    Raises:
        EmptyDrive: If a drive has no scan, or a method can use none of the places.
        InvalidParameters: If there is no query or no method, a name comes twice, or no scan of
            a drive has a pose.
    """
    names = [method.name for method in methods]
    if not names or len(set(names)) < len(names):
        raise InvalidParameters(f"the methods are {names}, wanted one or more, each once")
    queried = drive if query_drive is None else query_drive
    paired = _with_poses(protocol.pairing.pair(drive, query_drive), drive, queried)
    enrolled = [method.enrol(drive, paired.places, progress) for method in methods]

    def answers(
        of: Drive, scans: IntArray, first_excluded: IntArray, stage: str
    ) -> list[list[list[_Answer | None]]]:
        queries = QuerySet(
            of, scans, protocol.conditions, protocol.seed, recording=protocol.recording
        )
        return queries.answers(
            [partial(_answer, places, first_excluded) for places in enrolled], stage, progress
        )

    answered = answers(queried, paired.queries, paired.first_excluded, "querying")
    unknown: list[list[list[_Answer | None]]] | None = None
    if unknown_drive is not None:
        scans = np.arange(0, len(unknown_drive), protocol.unknown_every)
        everything = np.full(len(scans), len(drive))
        unknown = answers(unknown_drive, scans, everything, "querying unknown places")
    queries = queried.poses[paired.queries]
    _, nearest_m = nearest_place(
        drive.poses[paired.places],
        queries,
        np.searchsorted(paired.places, paired.first_excluded),
    )
    return Comparison(
        drive=drive.name,
        query_drive=None if query_drive is None else query_drive.name,
        unknown_drive=None if unknown_drive is None else unknown_drive.name,
        protocol=str(protocol.pairing),
        scans=len(drive),
        seed=protocol.seed,
        methods=tuple(
            MethodResult(
                name=method.name,
                configuration=method.configuration(),
                places=len(places.scans),
                sent_bytes=places.sent_bytes,
                stored_bytes=places.stored_bytes,
                conditions=tuple(
                    _summarize(
                        condition,
                        answered[row][column],
                        None if unknown is None else unknown[row][column],
                        drive.poses,
                        queries,
                        nearest_m,
                        protocol,
                    )
                    for column, condition in enumerate(protocol.conditions)
                ),
            )
            for row, (method, places) in enumerate(zip(methods, enrolled, strict=True))
        ),
    )


def _with_poses(paired: Paired, drive: Drive, queried: Drive) -> Paired:
    """Leave out scans without a pose, whose answers cannot be checked."""
    placed, located = is_known(drive.poses[paired.places]), is_known(queried.poses[paired.queries])
    for of, known in ((drive, placed), (queried, located)):
        if not known.any():
            raise InvalidParameters(
                f"drive {of.name} has no scan with a pose: answers cannot be checked"
            )
    return Paired(paired.places[placed], paired.queries[located], paired.first_excluded[located])


def _answer(enrolled: Enrolled, first_excluded: IntArray, query: int, scan: Scan) -> _Answer:
    before = int(np.searchsorted(enrolled.scans, first_excluded[query]))
    begun = time.process_time()  # not wall time: other work on the machine must not count
    match = enrolled.describe(scan)
    described = time.process_time()
    found = match(None if before == len(enrolled.scans) else before)
    describe_s, match_s = described - begun, time.process_time() - described
    if found is None:
        return _Answer(describe_s=describe_s, match_s=match_s)
    return _Answer(
        int(enrolled.scans[found.row]),
        -found.distance,
        nan_if_none(found.relative_yaw_deg),
        describe_s,
        match_s,
    )


def _summarize(
    condition: Condition,
    answers: Sequence[_Answer | None],
    unknown: Sequence[_Answer | None] | None,
    places: FloatArray,
    queries: FloatArray,
    nearest_m: FloatArray,
    protocol: ComparisonProtocol,
) -> MethodUnderCondition:
    given = [answer or _REFUSED for answer in answers]
    answered = np.array([answer.scan for answer in given])
    scores = _scores(answers)
    distance_m = np.where(answered >= 0, apart_m(places[answered], queries), math.inf)
    findable, recall, f1, precision = {}, {}, {}, {}
    counting = protocol.counting
    for metres in protocol.tolerances_m:
        right, has_place = distance_m <= metres, nearest_m <= metres
        count = int(has_place.sum())
        curve = precision_recall(
            scores,
            right,
            count,
            ignored=~right & (distance_m <= (counting.wrong_beyond_m or metres)),
            rejectable=has_place if counting.of_rejected else None,
        )
        findable[metres] = count
        recall[metres] = float(right.sum() / count) if count else None
        f1[metres] = curve.max_f1 if count else None
        precision[metres] = curve.average_precision if count else None
    widest_m = max(protocol.tolerances_m)
    error_deg = heading_error_deg(
        np.array([answer.relative_yaw_deg for answer in given]),
        heading_deg(queries) + condition.yaw_deg - heading_deg(places)[answered],
    )
    refusals = sum(answer is None for answer in answers)
    return MethodUnderCondition(
        condition=condition,
        queries=len(answers),
        refusals=refusals,
        unanswered=int((answered < 0).sum()) - refusals,
        findable=findable,
        recall_at_1=recall,
        max_f1=f1,
        average_precision=precision,
        novelty_auroc=None
        if unknown is None
        else auroc(scores[nearest_m <= widest_m], _scores(unknown)),
        heading_error_deg_median=median(error_deg[distance_m <= widest_m]),
        describe_ms_median=median(np.array([1e3 * answer.describe_s for answer in given])),
        match_ms_median=median(np.array([1e3 * answer.match_s for answer in given])),
    )


def _scores(answers: Sequence[_Answer | None]) -> FloatArray:
    return np.array([(answer or _REFUSED).score for answer in answers])
