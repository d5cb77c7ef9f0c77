"""What distances of limited queries mean in a map, measured on its own signatures."""

from collections.abc import Sequence

import numpy as np

from core.arrays import BoolArray
from core.confidence.places import elsewhere_from
from core.confidence.rescaling import Rescaling
from core.encodings.model import Model, QueryLimits
from core.encodings.signature import Signature
from core.scans.trajectory import Trajectory

_SAMPLED = 64  # scans of the map; each is searched twice
_TURN = 23  # sectors from one scan to the next: limits of azimuth are measured all around


def rescaling_for(
    model: Model, trajectory: Trajectory, revision: str, limits: QueryLimits
) -> Rescaling:
    """Return how distances of limited queries become distances of the map's own queries.

    Scans of the map are compared with all that were recorded elsewhere, with limits and without.

    Args:
        model: Of the map, in an encoding whose queries may have limits.
        trajectory: Of the map.
        revision: The map's.
        limits: Of the queries.

    Returns:
        The rescaling; one that changes nothing if no scan was recorded elsewhere.
    """
    rows = np.unique(np.linspace(0, len(trajectory) - 1, _SAMPLED).astype(np.int64)).tolist()
    by_limited, by_usual = [], []
    for number, (row, usual) in enumerate(
        zip(rows, model.own_queries(rows, revision), strict=True)
    ):
        elsewhere = elsewhere_from(trajectory, row)
        limited = model.limited_query(row, revision, limits, _TURN * number)
        if limited is not None and elsewhere.any():
            by_limited.append(_nearest(model, [limited], elsewhere))
            by_usual.append(_nearest(model, usual, elsewhere))
    if not by_usual:
        return Rescaling(shift=0.0, power=1.0)
    found = Rescaling.of_wrong_places(np.array(by_limited), np.array(by_usual))
    return found.weighted(limits.weight)


def _nearest(model: Model, signatures: Sequence[Signature], among: BoolArray) -> float:
    return float(model.search(signatures).nearest(1, among).distances[0])
