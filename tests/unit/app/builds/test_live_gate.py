"""Whether a build may replace the live revision, by the recall of both."""

import pytest

from app.builds.live_gate import MOST_BELOW_OLD, Compared
from app.builds.recall import NoRecall, OwnRecall, Recall

DIGEST = "0123456789ab" * 5


def of_both(this, other):
    return Recall(200, this, other, same_questions=True)


def fault(recall=None, old=0.9, new=None, max_recall_loss=0.02):
    recall = of_both(old, old) if recall is None else recall
    return Compared(recall, OwnRecall(200, old), new).fault(DIGEST, max_recall_loss)


@pytest.mark.parametrize("most", [0.0, 0.02, 0.1])
def test_a_loss_of_as_much_as_is_allowed_passes_and_one_query_more_does_not(most):
    for old in range(21, 201):
        assert fault(of_both((old - 200 * most) / 200, old / 200), max_recall_loss=most) is None
        refused = fault(of_both((old - 200 * most - 1) / 200, old / 200), max_recall_loss=most)
        assert refused is not None
        assert "it shares with live revision 0123456789ab" in refused


def test_new_drives_may_be_found_a_little_less():
    allowed = 0.9 - MOST_BELOW_OLD
    assert fault(new=OwnRecall(200, allowed)) is None
    assert "of its new drives" in (fault(new=OwnRecall(200, allowed - 0.005)) or "")
    assert fault(new=OwnRecall(200, allowed - 0.005), max_recall_loss=0.1) is None


def test_one_query_that_is_not_found_is_no_evidence_against_a_short_drive():
    assert fault(old=1.0, new=OwnRecall(12, 11 / 12)) is None
    assert fault(old=1.0, new=OwnRecall(12, 10 / 12)) is not None


@pytest.mark.parametrize("reason", NoRecall)
def test_what_cannot_be_measured_passes_only_where_no_scan_is_in_both(reason):
    assert (fault(reason) is None) == (reason is NoRecall.NO_SCAN_IN_BOTH)
    assert reason.value in (fault(new=reason) or "")
    unknown = Compared(reason, reason, None).fault(DIGEST, 1.0)
    assert unknown is not None
    assert "cannot be measured" in unknown
