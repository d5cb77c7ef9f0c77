"""An observation that contradicts the place of its track."""

from core.arrays import FloatArray
from core.confidence.places import away_from
from core.encodings.search import Search
from core.localization.candidates import find_candidates
from core.mapping.tensormap import TensorMap
from core.tracking.step import SURE


def contradicts(tensor_map: TensorMap, search: Search, likelihood: FloatArray, row: int) -> bool:
    """Return whether an observation alone is as certain to be away from a track's place.

    Two places cannot both have nine tenths. The motion holds the track at its own, and odometry
    in another unit is a wrong motion, which the observations' small weights cannot correct. Without
    a calibration an observation alone has no probability and contradicts nothing.

    Args:
        tensor_map: The map.
        search: The observation's.
        likelihood: `(K,)` of the observation at each scan.
        row: The scan at the track's place.
    """
    if tensor_map.calibration is None:
        return False
    away = away_from(tensor_map.trajectory, row)
    if not likelihood[away].max(initial=0.0) > likelihood[~away].max(initial=0.0):
        return False  # nearly always: nothing more is compared
    found = find_candidates(tensor_map, search, 1)
    decision = found.decide(tensor_map.calibration_of(search), SURE, None)
    return bool(away[found.matches.rows[0]]) and decision.localized
