"""The advisor on constructed candidates, where the right advice is known."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.errors import InvalidParameters
from core.evaluation.advisor import FEWEST_QUERIES, AdviceDecision, advise, standard_error
from core.evaluation.sweep import SweepPoint


def point(r1, r2, accuracy, *, k=100, segments=5, elements=None):
    elements = 1000 * r1 * r2 // k if elements is None else elements
    return SweepPoint(
        ranks=(r1, r2),
        segment_length=k,
        segments=segments,
        elements=elements,
        bytes_per_scan=4 * elements / 10,
        sent_bytes=21 + r1 * (2 * r2 - 1),
        relative_error=0.5,
        segment_accuracy=accuracy,
        accuracy=(accuracy, accuracy),
    )


RANKS = (2, 4, 8)


def grid(accuracy, **options):
    """Candidates of all ranks, each with `accuracy(r1, r2)`."""
    return [point(r1, r2, accuracy(r1, r2), **options) for r1 in RANKS for r2 in RANKS]


def test_it_recommends_the_smallest_of_those_that_do_not_differ_from_the_best() -> None:
    points = grid(lambda r1, r2: {4: 0.6, 8: 0.8, 16: 0.97, 32: 0.975, 64: 0.98}[r1 * r2])
    advice = advise(points, counted=100)
    assert advice.decision == AdviceDecision.DECIDED
    assert advice.best == points[-1]
    assert advice.recommended is not None
    assert advice.recommended.ranks == (8, 2)  # of three as large, the one that sends least
    assert any("less accurate" in reason for reason in advice.reasons)


def test_more_evidence_pays_for_a_larger_map() -> None:
    points = grid(lambda r1, r2: 0.98 if r1 * r2 < 64 else 0.99)
    few = advise(points, counted=50).recommended
    many = advise(points, counted=5000).recommended
    assert few is not None
    assert many is not None
    assert (few.ranks, many.ranks) == ((2, 2), (8, 8))


def test_if_all_are_equally_accurate_the_reason_is_that_the_evidence_does_not_decide() -> None:
    advice = advise(grid(lambda r1, r2: 1.0), counted=100)
    assert advice.decision == AdviceDecision.SIZE_ONLY
    assert advice.recommended is not None
    assert advice.recommended.ranks == (2, 2)
    assert not any(axis.worse for axis in advice.axes)
    assert any("does not decide" in reason for reason in advice.reasons)


def test_each_parameter_s_evidence_names_the_other_two_it_holds_for() -> None:
    """Another k is as accurate at larger ranks: without them this would contradict the best."""
    points = [
        point(r1, r2, 1.0 if k == 100 or r1 == 8 else 0.5, k=k, elements=r1 * r2 * 100 // k)
        for r1 in RANKS
        for r2 in RANKS
        for k in (50, 100)
    ]
    advice = advise(points, counted=100)
    assert advice.recommended is not None
    assert (advice.recommended.ranks, advice.recommended.segment_length) == ((2, 2), 100)
    *_, r1, r2, k = advice.reasons
    assert r1 == "r1, at r2 = 2 and k = 100: 2, 4, 8 are equally accurate."
    assert r2 == "r2, at r1 = 2 and k = 100: 2, 4, 8 are equally accurate."
    assert k == "k, at r1 = 2 and r2 = 2: 100; 50 is less accurate."
    assert "count as equally accurate" in advice.reasons[1]


def test_a_decision_is_never_called_undecided() -> None:
    advice = advise(grid(lambda r1, r2: 0.5 if r1 == 2 else 1.0), counted=100)
    assert advice.decision == AdviceDecision.DECIDED
    assert [axis.name for axis in advice.axes if not axis.worse] == ["r2", "k"]
    assert "does not decide" not in " ".join(advice.reasons)
    assert advice.reasons[-3:] == (
        "r1, at r2 = 2 and k = 100: 4, 8 are equally accurate; 2 is less accurate.",
        "r2, at r1 = 4 and k = 100: 2, 4, 8 are equally accurate.",
        "k, at r1 = 4 and r2 = 2: only 100 was tried.",
    )


def test_too_few_scans_never_give_a_decision() -> None:
    points = grid(lambda r1, r2: 0.2 if r1 == 2 else 1.0)
    assert advise(points, FEWEST_QUERIES - 1).decision == AdviceDecision.TOO_FEW
    assert advise(points, FEWEST_QUERIES).decision == AdviceDecision.DECIDED


def test_a_lucky_small_candidate_is_not_taken_when_larger_ranks_do_worse() -> None:
    lucky = grid(lambda r1, r2: 1.0 if (r1, r2) == (2, 2) else 0.7 if min(r1, r2) == 2 else 0.995)
    advice = advise(lucky, counted=100)
    assert advice.best is not None
    assert advice.best.ranks == (2, 2)
    assert advice.recommended is not None
    assert advice.recommended.ranks == (4, 4)


def test_the_best_is_taken_and_may_be_luck_where_no_other_candidate_confirms_it() -> None:
    alone = grid(lambda r1, r2: 1.0 if (r1, r2) == (4, 4) else 0.5)
    advice = advise(alone, counted=100)
    assert advice.recommended == point(4, 4, 1.0)
    assert (advice.confirmed, advice.decision) == (False, AdviceDecision.UNCONFIRMED)
    assert "that larger ranks confirm" not in " ".join(advice.reasons)
    assert "no larger rank confirms one" in advice.reasons[1]
    assert "It may be luck." in advice.reasons[1]
    assert "does not decide" in " ".join(advice.reasons)
    assert advise(alone, counted=FEWEST_QUERIES - 1).decision == AdviceDecision.TOO_FEW


def test_a_budget_leaves_out_what_is_larger() -> None:
    points = grid(lambda r1, r2: min(r1, r2) / 8)
    best = advise(points, counted=100).recommended
    assert best is not None
    assert best.ranks == (8, 8)
    budget = next(p.bytes_per_scan for p in points if p.ranks == (4, 4))
    small = advise(points, counted=100, max_bytes_per_scan=budget).recommended
    assert small is not None
    assert small.ranks == (4, 4)


def test_a_budget_that_is_too_small_is_reported_with_the_smallest_candidate() -> None:
    advice = advise(grid(lambda r1, r2: 1.0), counted=100, max_bytes_per_scan=1.0)
    assert (advice.decision, advice.recommended) == (AdviceDecision.NOTHING_FITS, None)
    assert f"{advice.smallest_bytes_per_scan:.0f}" in advice.reasons[0]
    json.dumps(advice.as_dict(), allow_nan=False)


def test_a_map_of_one_segment_is_taken_only_if_there_is_no_other() -> None:
    one, two = point(2, 2, 1.0, k=200, segments=1), point(2, 2, 1.0, k=100, segments=2)
    assert advise([one, two], counted=100).recommended == two
    assert advise([one], counted=100).recommended == one


def test_of_equally_large_and_accurate_ones_longer_segments_are_taken() -> None:
    short, long = (point(2, 2, 0.9, k=k, elements=50) for k in (50, 100))
    advice = advise([short, long], counted=100)
    assert advice.recommended == long
    assert [axis.name for axis in advice.axes if axis.worse] == []


def test_where_all_maps_are_as_large_the_fewest_bytes_sent_decide() -> None:
    points = grid(lambda r1, r2: 0.99 if min(r1, r2) > 2 else 0.6, elements=500)
    advice = advise(points, counted=100)
    assert advice.decision == AdviceDecision.DECIDED
    assert advice.recommended is not None
    assert (advice.recommended.ranks, advice.recommended.sent_bytes) == ((4, 4), 49)
    said = " ".join(advice.reasons)
    assert (
        "{4, 4, 100} sends the least of those that larger ranks confirm, with 49 bytes sent" in said
    )
    assert "candidates that send no more are less accurate" in said
    assert "small" not in said
    tied = advise(grid(lambda r1, r2: 1.0, elements=500), counted=100)
    assert tied.decision == AdviceDecision.SIZE_ONLY
    assert "no candidate that sends less was less accurate" in " ".join(tied.reasons)


@given(
    st.lists(
        st.tuples(st.sampled_from(RANKS), st.sampled_from(RANKS), st.integers(0, 50)), min_size=1
    ),
    st.integers(1, 500),
)
def test_the_advice_is_never_more_than_one_standard_error_below_the_best(drawn, queries) -> None:
    accuracy = {(r1, r2): hits / 50 for r1, r2, hits in drawn}
    points = [point(r1, r2, share) for (r1, r2), share in accuracy.items()]
    advice = advise(points, queries)
    assert advice.recommended is not None
    assert advice.best is not None
    assert advice.standard_error is not None
    assert advice.best.mean_accuracy == max(accuracy.values())
    assert (
        advice.recommended.mean_accuracy >= advice.best.mean_accuracy - advice.standard_error - 1e-9
    )


@given(st.integers(1, 300), st.data())
def test_a_standard_error_is_never_zero_and_falls_with_evidence(queries, data) -> None:
    share = data.draw(st.integers(0, queries)) / queries
    assert 0 < standard_error(share, 10 * queries) < standard_error(share, queries) < 0.5


@pytest.mark.parametrize("budget", [0.0, -1.0, float("nan")])
def test_a_budget_of_nothing_is_rejected(budget) -> None:
    with pytest.raises(InvalidParameters, match="max_bytes_per_scan"):
        advise([point(2, 2, 1.0)], 10, budget)


def test_an_empty_list_of_candidates_is_rejected() -> None:
    with pytest.raises(InvalidParameters, match="no candidate"):
        advise([], 10)
