"""What distances by fewer numbers mean in a map, measured on its own signatures."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from core.arrays import BoolArray
from core.confidence.places import elsewhere_from
from core.confidence.rescaling import Rescaling
from core.encodings.model import Model
from core.encodings.signature import Signature
from core.scans.trajectory import Trajectory

_SAMPLED = 64  # scans of the map; each is searched twice


def rescaling_for(
    model: Model, trajectory: Trajectory, revision: str, ranks: tuple[int, int]
) -> Rescaling:
    """Return how distances by fewer numbers become distances by those of the map's own queries.

    Scans of the map are compared with all that were recorded elsewhere, by either numbers.

    Args:
        model: Of the map, in an encoding whose queries may have fewer numbers.
        trajectory: Of the map.
        revision: The map's.
        ranks: `(r1, r2)` of the fewer numbers.

    Returns:
        The rescaling; one that changes nothing if no scan was recorded elsewhere.
    """
    rows = np.unique(np.linspace(0, len(trajectory) - 1, _SAMPLED).astype(np.int64)).tolist()
    by_fewer, by_usual = [], []
    for row, usual in zip(rows, model.own_queries(rows, revision), strict=True):
        elsewhere = elsewhere_from(trajectory, row)
        if elsewhere.any():
            by_fewer.append(_nearest(model, [_first(one, ranks) for one in usual], elsewhere))
            by_usual.append(_nearest(model, usual, elsewhere))
    if not by_usual:
        return Rescaling(shift=0.0, power=1.0)
    return Rescaling.of_wrong_places(np.array(by_fewer), np.array(by_usual))


def _nearest(model: Model, signatures: Sequence[Signature], among: BoolArray) -> float:
    return float(model.search(signatures).nearest(1, among).distances[0])


def _first(signature: Signature, ranks: tuple[int, int]) -> Signature:
    r1, r2 = ranks
    return replace(signature, values=signature.values[:r1, :r2])
