"""The belief before an observation, however long the last one is ago."""

import math

import numpy as np

from core.tracking.belief import Belief
from core.tracking.graph import TravelGraph
from core.tracking.motion import Motion
from core.tracking.place import NEAR_M
from core.tracking.strides import STRIDE_M
from core.tracking.walks import MAX_STRIDES

LONGEST_SHARE = 10.0
"""Time between two observations, as a share of the usual one: after more there is a gap."""

_SHORTEST_SHARE = 0.1
_SHARE_ONCE = 0.8  # of a walk, on average: most of the spread around it is within the walk
# Of a walk that does not end at the end of a drive, where no number of strides leads farther: a
# stride is one scan of a third of a metre at least, as two are nearer half a metre otherwise.
_SHORTEST_M = MAX_STRIDES * STRIDE_M * 2.0 / 3.0
_MOST_PARTS = 16  # some 300 strides


def predicted(
    belief: Belief, graph: TravelGraph, motion: Motion, share: float, travelled_m: float | None
) -> Belief | None:
    """Return the belief before the next observation, `None` where too little is known of the way.

    Walks have at most `MAX_STRIDES`: a longer way is predicted in equal parts. A pace says
    nothing of a gap; odometry does.

    Args:
        belief: After the last observation.
        graph: The map's graph.
        motion: How vehicles move.
        share: Time since the last observation, as a share of the usual one.
        travelled_m: Odometry since the last observation, negative backwards.
    """
    bounded = min(max(share, _SHORTEST_SHARE), LONGEST_SHARE)
    place = int(belief.of_place.argmax())
    if travelled_m is not None and graph.has_lengths:
        reach_m = float(graph.walks.length_m[-1, place ^ (travelled_m < 0.0)])
    else:
        reach_m = math.nan
    if travelled_m is not None and not math.isnan(reach_m):
        way_m = abs(travelled_m)
        if way_m > _MOST_PARTS * _SHARE_ONCE * max(reach_m, NEAR_M):
            return None
        parts = _parts_of(way_m, motion.metres_sigma(way_m), max(reach_m, _SHORTEST_M))
    elif share > LONGEST_SHARE:
        return None
    else:
        at = belief.by_pace(np.array([place]))[0]
        strides = bounded * float(at @ motion.pace) / max(float(at.sum()), np.finfo(float).tiny)
        parts = max(1, math.ceil(strides / (_SHARE_ONCE * MAX_STRIDES)))
        if parts > _MOST_PARTS:
            return None
    for _ in range(parts):
        belief = belief.predicted(graph, motion, bounded, travelled_m, parts)
    return belief


def _parts_of(way_m: float, sigma_m: float, reach_m: float) -> int:
    """Return the fewest equal parts of a way of which each is within a walk, with its spread.

    The mean and twice the standard deviation: `way_m / parts + 2 sigma_m / sqrt(parts)`.
    """
    root = (sigma_m + math.sqrt(sigma_m * sigma_m + way_m * reach_m)) / reach_m
    return min(max(1, math.ceil(root * root)), _MOST_PARTS)
