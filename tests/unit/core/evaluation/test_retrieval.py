"""Precision, recall, F1, average precision and AUROC by hand, and by their definitions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.errors import InvalidParameters
from core.evaluation.retrieval import auroc, precision_recall

SCORE = st.sampled_from([-np.inf, -2.0, -1.5, -1.0, -0.5, 0.0])
QUERIES = st.lists(st.tuples(SCORE, st.booleans()), min_size=1, max_size=12)


def test_a_curve_by_hand():
    scores = np.array([0.9, 0.8, 0.7, 0.6, 0.5])
    right = np.array([True, True, False, True, False])
    curve = precision_recall(scores, right, findable=4)
    assert len(curve.precision) == len(scores)
    np.testing.assert_allclose(curve.precision, [1, 1, 2 / 3, 3 / 4, 3 / 5])
    np.testing.assert_allclose(curve.recall, [1 / 4, 1 / 2, 1 / 2, 3 / 4, 3 / 4])
    assert curve.max_f1 == pytest.approx(3 / 4)
    assert curve.average_precision == pytest.approx(1 / 4 + 1 / 4 + (1 / 4) * (3 / 4))


def test_equal_scores_are_accepted_together():
    curve = precision_recall(np.array([1.0, 1.0]), np.array([True, False]), findable=1)
    assert (curve.precision.tolist(), curve.recall.tolist()) == ([0.5], [1.0])


def test_an_unanswered_query_counts_as_missed():
    scores = np.array([-1.0, -np.inf])
    curve = precision_recall(scores, np.array([True, False]), findable=2)
    assert curve.max_f1 == pytest.approx(2 / 3)
    assert curve.average_precision == 0.5
    nothing = precision_recall(np.array([-np.inf]), np.array([False]), findable=1)
    assert (len(nothing.precision), nothing.max_f1, nothing.average_precision) == (0, 0.0, 0.0)


def test_invalid_values_are_rejected():
    with pytest.raises(InvalidParameters, match="a score is NaN"):
        precision_recall(np.array([np.nan]), np.array([True]), 1)
    with pytest.raises(InvalidParameters, match="a score is NaN"):
        precision_recall(np.array([1.0]), np.array([True, False]), 2)
    with pytest.raises(InvalidParameters, match="only 0 findable"):
        precision_recall(np.array([1.0]), np.array([True]), 0)
    with pytest.raises(InvalidParameters, match="NaN"):
        auroc(np.array([np.nan]), np.array([1.0]))


@given(queries=QUERIES, more=st.integers(0, 3))
def test_the_curve_is_its_definition(queries, more):
    scores = np.array([score for score, _ in queries])
    right = np.array([good and score > -np.inf for score, good in queries])
    findable = max(1, int(right.sum()) + more)
    curve = precision_recall(scores, right, findable)
    best, area, reached = 0.0, 0.0, 0.0
    for threshold in sorted({score for score in scores.tolist() if score > -np.inf}, reverse=True):
        accepted = scores >= threshold
        precision = right[accepted].sum() / accepted.sum()
        recall = right[accepted].sum() / findable
        area += (recall - reached) * precision
        reached = recall
        if precision + recall > 0:
            best = max(best, 2 * precision * recall / (precision + recall))
    assert curve.max_f1 == pytest.approx(best)
    assert curve.average_precision == pytest.approx(area)


@given(positives=st.lists(SCORE, min_size=1), negatives=st.lists(SCORE, min_size=1))
def test_auroc_is_the_share_of_pairs_in_order(positives, negatives):
    pairs = [(p > n) + 0.5 * (p == n) for p in positives for n in negatives]
    assert auroc(np.array(positives), np.array(negatives)) == pytest.approx(np.mean(pairs))


def test_auroc_of_nothing_is_unknown():
    assert auroc(np.array([1.0]), np.array([])) is None
    assert auroc(np.array([2.0, 3.0]), np.array([1.0])) == 1.0
    assert auroc(np.array([1.0]), np.array([2.0, -np.inf])) == 0.5
