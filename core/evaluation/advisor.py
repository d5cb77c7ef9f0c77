"""Which {r1, r2, k} to take, and how strong the evidence is (paper, sec. 3.2).

The paper looks for the parameters of "highest accuracy, while being efficient in terms of the
storage requirements". As a rule: of all candidates whose accuracy on held-out scans is within one
standard error of the best one's, take the smallest; where all are as large, as maps that answer any
view are, the one of which a vehicle sends the fewest bytes. Among hundreds of candidates some small
one answers well by luck; a larger rank keeps all that a smaller one does, so a candidate is only
taken if its neighbours of the next larger r1 and r2 are within that error too.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from core.errors import InvalidParameters
from core.evaluation.plain import Plain
from core.evaluation.sweep import SweepPoint, sizes_differ
from core.numbers import require_above
from core.text import verb_of

FEWEST_QUERIES = 30
"""With fewer held-out scans one standard error at 90 % is more than 5 points."""


class AdviceDecision(StrEnum):
    """How strong the evidence is."""

    DECIDED = "decided"
    UNCONFIRMED = "unconfirmed"
    SIZE_ONLY = "size_only"
    TOO_FEW = "too_few"
    NOTHING_FITS = "nothing_fits"


@dataclass(frozen=True)
class Axis:
    """The evidence on one parameter, the other two as recommended.

    Attributes:
        name: `r1`, `r2` or `k`.
        chosen: The recommended value.
        tied: Values within one standard error of the best candidate.
        worse: Values that are not.
    """

    name: str
    chosen: int
    tied: tuple[int, ...]
    worse: tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class Advice(Plain):
    """A recommendation and its reasons.

    Attributes:
        decision: How strong the evidence is.
        recommended: The smallest candidate within one standard error of the best that larger ranks
            confirm, the best one where they confirm none; `None` if none fits the budget.
        best: The most accurate candidate that fits, the smallest among equals.
        standard_error: The standard error of the best one's accuracy.
        counted: Held-out scans that count.
        fitting: How many candidates fit the budget.
        tied: How many of them are within one standard error of the best.
        max_bytes_per_scan: The budget, `None` without one.
        smallest_bytes_per_scan: The fewest bytes per scan of all candidates.
        confirmed: Whether larger ranks confirm the recommended one.
        axes: The evidence on r1, r2 and k.
        reasons: The reasons in sentences.
    """

    decision: AdviceDecision
    recommended: SweepPoint | None = None
    best: SweepPoint | None = None
    standard_error: float | None = None
    counted: int
    fitting: int
    tied: int = 0
    max_bytes_per_scan: float | None
    smallest_bytes_per_scan: float
    confirmed: bool = False
    axes: tuple[Axis, ...] = ()
    reasons: tuple[str, ...] = ()


def standard_error(share: float, counted: int) -> float:
    """Return the standard deviation of a share's Jeffreys posterior: above 0 even at 1.0.

    A scan that is queried under several conditions counts once; its mean answer varies no more than
    one answer does, so this is the standard error at most.

    Examples:
        >>> round(standard_error(0.9, 100), 4), round(standard_error(1.0, 50), 4)
        (0.0302, 0.0137)
    """
    hits, misses = share * counted + 0.5, (1.0 - share) * counted + 0.5
    total = hits + misses
    return math.sqrt(hits * misses / (total * total * (total + 1.0)))


def advise(
    points: Sequence[SweepPoint], counted: int, max_bytes_per_scan: float | None = None
) -> Advice:
    """Recommend a candidate.

    Candidates are ordered by storage; among equally large ones the one comes first of which fewer
    bytes are sent, then the more accurate one, then the one of longer segments, which the paper
    prefers, then of smaller ranks.

    Args:
        points: The candidates; those of one segment count only if there are no others: a map of one
            segment does not say where along the drive the vehicle is.
        counted: How many held-out scans each accuracy is of.
        max_bytes_per_scan: Leave out candidates that are larger.

    Raises:
        InvalidParameters: If there is no candidate, or the budget is not above 0.
    """
    if not points:
        raise InvalidParameters("there is no candidate to recommend")
    require_above(0, max_bytes_per_scan=max_bytes_per_scan)
    candidates = [p for p in points if p.segments > 1] or list(points)
    smallest = min(p.bytes_per_scan for p in candidates)
    budget = math.inf if max_bytes_per_scan is None else max_bytes_per_scan
    fitting = [p for p in candidates if p.bytes_per_scan <= budget]
    advice = Advice(
        decision=AdviceDecision.NOTHING_FITS,
        counted=counted,
        fitting=len(fitting),
        max_bytes_per_scan=max_bytes_per_scan,
        smallest_bytes_per_scan=smallest,
    )
    if not fitting:
        return replace(advice, reasons=_reasons(advice, (), by_size=True))
    ordered = sorted(fitting, key=lambda p: (p.size, -p.mean_accuracy, -p.segment_length, p.ranks))
    best = max(ordered, key=lambda p: p.mean_accuracy)  # the first, so the smallest, of equals
    error = standard_error(best.mean_accuracy, counted)
    bar = best.mean_accuracy - error - 1e-12
    tied = [p for p in ordered if p.mean_accuracy >= bar]
    supported = _supported(candidates, tied, bar)
    recommended = supported[0] if supported else best
    ruled_out = [p for p in ordered if p.mean_accuracy < bar and p.size <= recommended.size]
    advice = replace(
        advice,
        decision=_decision(counted, confirmed=bool(supported), rules_out_smaller=bool(ruled_out)),
        recommended=recommended,
        best=best,
        standard_error=error,
        tied=len(tied),
        confirmed=bool(supported),
        axes=_axes(ordered, recommended, bar),
    )
    return replace(advice, reasons=_reasons(advice, ruled_out, by_size=sizes_differ(candidates)))


def _decision(counted: int, *, confirmed: bool, rules_out_smaller: bool) -> AdviceDecision:
    if counted < FEWEST_QUERIES:
        return AdviceDecision.TOO_FEW
    if not confirmed:
        return AdviceDecision.UNCONFIRMED
    return AdviceDecision.DECIDED if rules_out_smaller else AdviceDecision.SIZE_ONLY


def _supported(
    candidates: Sequence[SweepPoint], tied: Sequence[SweepPoint], bar: float
) -> list[SweepPoint]:
    """Return the tied candidates whose neighbours of larger ranks, where tried, are tied as well.

    Neighbours beyond the budget count too.
    """
    at = {(p.segment_length, p.ranks): p.mean_accuracy for p in candidates}

    def above(axis: int, rank: int) -> int:
        return min((p.ranks[axis] for p in candidates if p.ranks[axis] > rank), default=rank)

    def is_supported(p: SweepPoint) -> bool:
        r1, r2 = p.ranks
        larger = ((above(0, r1), r2), (r1, above(1, r2)))
        return all(at.get((p.segment_length, ranks), 1.0) >= bar for ranks in larger)

    return [p for p in tied if is_supported(p)]


def _axes(ordered: Sequence[SweepPoint], chosen: SweepPoint, bar: float) -> tuple[Axis, ...]:
    def values(point: SweepPoint) -> tuple[int, int, int]:
        return (*point.ranks, point.segment_length)

    own = values(chosen)
    axes = []
    for axis, name in enumerate(("r1", "r2", "k")):
        others = [other for other in range(3) if other != axis]
        along = [p for p in ordered if all(values(p)[other] == own[other] for other in others)]
        tied = sorted(values(p)[axis] for p in along if p.mean_accuracy >= bar)
        worse = sorted(values(p)[axis] for p in along if p.mean_accuracy < bar)
        axes.append(Axis(name, own[axis], tuple(tied), tuple(worse)))
    return tuple(axes)


def _reasons(advice: Advice, ruled_out: Sequence[SweepPoint], *, by_size: bool) -> tuple[str, ...]:
    """Return the reasons; `by_size` where candidates differ in storage."""
    best, chosen = advice.best, advice.recommended
    if best is None or chosen is None or advice.standard_error is None:
        return (
            f"No candidate fits {advice.max_bytes_per_scan:g} bytes per scan: the smallest takes"
            f" {advice.smallest_bytes_per_scan:.0f}.",
        )
    size = f"{chosen.bytes_per_scan:.0f} bytes per scan"
    if not by_size:
        size = f"{chosen.sent_bytes} bytes sent a query ({size}, as all have)"
    figures = f"{size} and {100 * chosen.mean_accuracy:.1f} %"
    is_least = "is the smallest" if by_size else "sends the least"
    within = (
        f"{advice.tied} of them are within one standard error of it, and count as equally accurate"
    )
    reasons = [
        f"The best of {advice.fitting} candidates, {_named(best)}, answers"
        f" {100 * best.mean_accuracy:.1f} % of {advice.counted} held-out scans right, with a"
        f" standard error of {100 * advice.standard_error:.1f} points.",
        f"{within}; {_named(chosen)} {is_least} of those that larger ranks confirm, with {figures}."
        if advice.confirmed
        else f"{within}; no larger rank confirms one; {_named(chosen)} is the most accurate,"
        f" with {figures}. It may be luck.",
    ]
    if ruled_out:
        nearest = max(ruled_out, key=lambda p: p.mean_accuracy)
        reasons.append(
            f"{len(ruled_out)} candidates"
            f" {'as small or smaller' if by_size else 'that send no more'} are less accurate than"
            f" that; the best of them, {_named(nearest)}, reaches"
            f" {100 * nearest.mean_accuracy:.1f} %."
        )
    if advice.decision == AdviceDecision.TOO_FEW:
        reasons.append(
            f"The evidence does not decide: only {advice.counted} scans count, and at least"
            f" {FEWEST_QUERIES} are needed. Take a longer drive."
        )
    elif advice.decision == AdviceDecision.UNCONFIRMED:
        reasons.append(
            "The evidence does not decide: larger ranks keep all that smaller ones do, and are less"
            " accurate here. Try more ranks, or a longer drive."
        )
    elif advice.decision == AdviceDecision.SIZE_ONLY:
        reasons.append(
            "The evidence does not decide: no candidate that"
            f" {'is smaller' if by_size else 'sends less'} was less accurate. This one is chosen"
            " for its size alone; evaluate it with harder queries, such as a second drive over the"
            " same streets, before you rely on it."
        )
    return (*reasons, *(_of_axis(axis, advice.axes) for axis in advice.axes))


def _of_axis(axis: Axis, axes: Sequence[Axis]) -> str:
    """Return the evidence on one parameter; with other values of the others it may be another."""
    others = " and ".join(f"{other.name} = {other.chosen}" for other in axes if other is not axis)
    of = f"{axis.name}, at {others}"
    if not axis.worse and len(axis.tied) == 1:
        return f"{of}: only {axis.chosen} was tried."
    equal = f"{axis.chosen}"
    if len(axis.tied) > 1:
        equal = f"{_listed(axis.tied)} are equally accurate"
    if not axis.worse:
        return f"{of}: {equal}."
    less = f"{_listed(axis.worse)} {verb_of(len(axis.worse), 'is', 'are')} less accurate"
    return f"{of}: {equal}; {less}."


def _listed(values: Sequence[int]) -> str:
    return ", ".join(map(str, values))


def _named(point: SweepPoint) -> str:
    return f"{{r1, r2, k}} = {{{point.ranks[0]}, {point.ranks[1]}, {point.segment_length}}}"
