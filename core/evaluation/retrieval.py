"""How well a score separates right answers from wrong ones: precision, recall, F1, AUROC.

An answer is accepted when its score reaches a threshold. Precision is the share of accepted answers
that are right; recall is the share of all *findable* queries that have an accepted, right answer.
A query without an answer has score minus infinity: it is never accepted, but is counted among the
findable ones. Answers of equal score are accepted together.
"""

from dataclasses import dataclass

import numpy as np

from core.arrays import BoolArray, FloatArray
from core.errors import InvalidParameters


@dataclass(frozen=True)
class Counting:
    """What precision and recall count where a published script counts otherwise.

    Attributes:
        wrong_beyond_m: An answer between the tolerance and so many metres is neither right nor
            wrong; `None` if every other answer is wrong.
        of_rejected: Whether recall is the share among right answers and rejected findable queries,
            so that a findable query with an accepted wrong answer leaves the denominator.
    """

    wrong_beyond_m: float | None = None
    of_rejected: bool = False


@dataclass(frozen=True, eq=False)
class PrecisionRecall:
    """Precision and recall at every threshold that is some answer's score, falling.

    Attributes:
        precision: `(n,)`.
        recall: `(n,)`, never falling.
    """

    precision: FloatArray
    recall: FloatArray

    @property
    def max_f1(self) -> float:
        """The greatest harmonic mean of precision and recall, 0 if nothing is ever right."""
        both = self.precision + self.recall
        f1 = np.divide(
            2.0 * self.precision * self.recall, both, out=np.zeros_like(both), where=both > 0
        )
        return float(f1.max(initial=0.0))

    @property
    def average_precision(self) -> float:
        """The area under the curve as a sum of steps, sum_n (R_n - R_(n-1)) P_n with R_0 = 0.

        Not the trapezoid rule, which interpolates between thresholds. Recall that is never reached
        adds nothing.
        """
        return float(np.sum(np.diff(self.recall, prepend=0.0) * self.precision))


def precision_recall(
    scores: FloatArray,
    right: BoolArray,
    findable: int,
    *,
    ignored: BoolArray | None = None,
    rejectable: BoolArray | None = None,
) -> PrecisionRecall:
    """Return the curve of a set of queries.

    Args:
        scores: `(n,)`, greater is more certain; minus infinity where there is no answer.
        right: `(n,)` whether the answer is right.
        findable: How many of all queries are findable, at least as many as are right.
        ignored: `(n,)` which answers precision does not count.
        rejectable: `(n,)` which queries are findable, if recall is of the right answers and those
            of them that are rejected; see `Counting`.

    Raises:
        InvalidParameters: If shapes differ, a score is NaN, or fewer are findable than right.

    Examples:
        >>> curve = precision_recall(np.array([3.0, 2.0, 1.0]), np.array([True, False, True]), 2)
        >>> curve.recall.tolist(), curve.precision.round(3).tolist()
        ([0.5, 0.5, 1.0], [1.0, 0.5, 0.667])
        >>> round(curve.max_f1, 3), round(curve.average_precision, 3)
        (0.8, 0.833)
    """
    if scores.ndim != 1 or scores.shape != right.shape or np.isnan(scores).any():
        raise InvalidParameters(
            f"scores {scores.shape} and right {right.shape} differ in shape, or a score is NaN"
        )
    answered = np.isfinite(scores) | (scores > 0)
    true = right & answered
    if findable < true.sum():
        raise InvalidParameters(f"{true.sum()} answers are right, but only {findable} findable")
    order = np.argsort(-scores[answered], kind="stable")
    falling = scores[answered][order]
    last_of_equals = np.append(falling[1:] != falling[:-1], True)[: len(falling)]
    found = np.cumsum(true[answered][order])[last_of_equals]
    counted = np.ones(len(falling), bool) if ignored is None else ~ignored[answered][order]
    accepted = np.cumsum(counted)[last_of_equals]
    wanted: FloatArray | int = findable
    if rejectable is not None:
        kept = np.cumsum(rejectable[answered][order])[last_of_equals]
        wanted = found + rejectable.sum() - kept
    return PrecisionRecall(found / np.maximum(accepted, 1), found / np.maximum(wanted, 1))


def auroc(positives: FloatArray, negatives: FloatArray) -> float | None:
    """Return the probability that a positive's score is above a negative's, equal ones half.

    It is the area under the receiver operating characteristic: 1 separates them, 0.5 is chance.
    `None` if there is none of either. Infinite scores are allowed.

    Raises:
        InvalidParameters: If a score is NaN.

    Examples:
        >>> auroc(np.array([3.0, 1.0]), np.array([2.0, 1.0]))
        0.625
    """
    if np.isnan(positives).any() or np.isnan(negatives).any():
        raise InvalidParameters("a score is NaN")
    if not (len(positives) and len(negatives)):
        return None
    lower = np.sort(negatives)
    # Of the negatives below, those that are as high count half.
    beaten = np.searchsorted(lower, positives, "left") + np.searchsorted(lower, positives, "right")
    return float(beaten.sum() / (2 * len(positives) * len(negatives)))
