"""Limits come in few classes, on every grid."""

import pytest

from core.encodings.harmonic.query_limits import limits_of, limits_of_scan
from core.projection.visibility import MOST_RINGS, View

RANKS = (6, 7)


@pytest.mark.parametrize("rings", [3, 12, 16, 20, 26, 32, 47, 60])
@pytest.mark.parametrize("hidden", [0, 30, 55])
def test_a_short_reach_has_a_class_on_a_grid_of_any_number_of_rings(rings, hidden):
    for reach in range(1, MOST_RINGS + 1):
        view = View(tuple(range(hidden)), reach)
        for limits in (limits_of(RANKS, RANKS, view, rings), limits_of_scan(RANKS, view, rings)):
            if limits is not None:
                assert limits.view.rings is not None
                assert abs(limits.view.rings - reach) <= max(1.0, rings / 16 + 0.5)
