"""Query sets: what is known of each query."""

import numpy as np

from core.evaluation.condition import Condition
from core.evaluation.query_set import LocatedQueries
from tests.support.samples import sample_drive


def test_a_rejected_query_takes_what_is_known_of_it_along():
    queries = LocatedQueries(
        sample_drive(6),
        np.array([1, 3, 5]),
        (Condition(),),
        0,
        segment=np.array([4, 5, 6]),
        segments_there=np.array([[4, 4], [5, 6], [6, 6]]),
        nearest_m=np.array([0.1, 0.2, 0.3]),
    )
    answered, given = queries.answered(["first", None, "last"])
    assert given == ["first", "last"]
    assert answered.scans.tolist() == [1, 5]
    assert answered.segment.tolist() == [4, 6]
    assert answered.segments_there.tolist() == [[4, 4], [6, 6]]
    assert answered.nearest_m.tolist() == [0.1, 0.3]
    assert answered.poses[:, 0].tolist() == [1.0, 5.0]
