"""What a comparison found."""

from dataclasses import dataclass
from typing import Any

from core.evaluation.condition import Condition
from core.evaluation.plain import Plain


@dataclass(frozen=True)
class MethodUnderCondition(Plain):
    """One method, all queries under one condition; what does not apply is `None`.

    Distances in metres are the keys of mappings: a query is *findable* within so many metres if a
    place that it may be compared with was recorded so near, and an answer is right if the place it
    names was.

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
        heading_error_deg_median: Over right answers (within the greatest distance) that tell one.
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
        name: Its name.
        configuration: All its parameters.
        places: How many scans it keeps as places.
        sent_bytes: What a vehicle sends for a query, `None` where that has no fixed size.
        stored_bytes: What is kept, a place; `None` where the method does not tell.
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
    """Several methods on the same scans.

    Attributes:
        drive: Name of the drive that the places are of.
        query_drive: Name of the drive that the queries are of, `None` if it was the same.
        unknown_drive: Name of the drive of other places, `None` without one.
        protocol: How places and queries were chosen, in words.
        scans: How many scans the drive has.
        seed: Of the noise.
        methods: The figures.
    """

    drive: str
    query_drive: str | None
    unknown_drive: str | None
    protocol: str
    scans: int
    seed: int
    methods: tuple[MethodResult, ...]
