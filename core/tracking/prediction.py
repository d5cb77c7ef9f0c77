"""The belief before an observation, however long the last one is ago."""

import math

import numpy as np

from core.tracking.belief import Belief
from core.tracking.graph import TravelGraph
from core.tracking.motion import Motion
from core.tracking.place import NEAR_M
from core.tracking.walks import MAX_STEPS

LONGEST_SHARE = 10.0
"""Time between two observations, as a share of the usual one: after more there is a gap."""

_SHORTEST_SHARE = 0.1
_STEPS_ONCE = 0.8 * MAX_STEPS  # on average: most of the spread around it is within the walks
_MOST_PARTS = 16  # some 300 scans


def predicted(
    belief: Belief, graph: TravelGraph, motion: Motion, share: float, travelled_m: float | None
) -> Belief | None:
    """Return the belief before the next observation, `None` where too little is known of the way.

    Walks have at most `MAX_STEPS` scans: a longer way is predicted in equal parts. A pace says
    nothing of a gap; odometry does.

    Args:
        belief: After the last observation.
        graph: The map's graph.
        motion: How vehicles move.
        share: Time since the last observation, as a share of the usual one.
        travelled_m: Odometry since the last observation, negative backwards.
    """
    scale = min(max(share, _SHORTEST_SHARE), LONGEST_SHARE)
    place = int(belief.of_place.argmax())
    if travelled_m is not None and graph.has_lengths:
        reach_m = float(graph.walks.length_m[-1, place ^ (travelled_m < 0.0)])
    else:
        reach_m = math.nan
    if travelled_m is not None and not math.isnan(reach_m):
        # At the end of a drive, and where the mapping vehicle stood, walks are short.
        scans = MAX_STEPS * abs(travelled_m) / max(reach_m, NEAR_M)
    elif share > LONGEST_SHARE:
        return None
    else:
        at = belief.by_pace(np.array([place]))[0]
        scans = scale * float(at @ motion.pace) / max(float(at.sum()), np.finfo(float).tiny)
    parts = max(1, math.ceil(scans / _STEPS_ONCE))
    if parts > _MOST_PARTS:
        return None
    part_m = None if travelled_m is None else travelled_m / parts
    for _ in range(parts):
        belief = belief.predicted(graph, motion, scale / parts, part_m)
    return belief
