"""Detection of a stationary vehicle from its signatures alone."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from core.arrays import BoolArray, FloatArray, IntArray, frozen
from core.encodings.registry import encoding_named
from core.encodings.signature import Signature
from core.mapping.tensormap import TensorMap
from core.scans.sampling import spread_evenly

_MOVING_QUANTILE = 0.75  # of the map's own changes, at least half of them of a moving vehicle
_STOOD_M = 0.05  # most of a step of a vehicle that stood: half a metre a second at 10 Hz
_SHARE = 0.4  # of that: the vehicle moved by less than half the distance between scans of the map
_STEP_M = 2.0  # of scans farther apart the change over so much of their way, as if it were even
_STATIONARY_RATE = 0.9  # of detections of a stationary vehicle that are right
_MOVING_RATE = 0.7  # likewise of a moving one: a slow one seems to be stationary
_INDEPENDENT = 2.0  # steps: over one the same things look alike
_FIRM = 2  # small changes in a row before a vehicle counts as stationary


def change(before: Sequence[Signature], after: Sequence[Signature]) -> float | None:
    """Return the change of signatures, 1 - <g, h> / (|g| |h|), without a search over headings.

    Of those of other ranks, as a vehicle sends when its view becomes narrow, the numbers count that
    both have. `None` if they have no segment in common or one is zero.
    """
    earlier = {s.segment: s.values for s in before}
    product = one = other = 0.0
    for signature in after:
        if (values := earlier.get(signature.segment)) is None:
            continue
        encoding = encoding_named(signature.encoding)
        r1, r2 = map(min, values.shape, signature.values.shape)
        g, h = encoding.weighted(values[:r1, :r2]), encoding.weighted(signature.values[:r1, :r2])
        product += float(np.vdot(g, h).real)
        one += float(np.vdot(g, g).real)
        other += float(np.vdot(h, h).real)
    if one <= 0.0 or other <= 0.0:
        return None
    return max(0.0, 1.0 - product / math.sqrt(one * other))


def changes_of_map(tensor_map: TensorMap) -> FloatArray:
    """Return the change from each scan of the map to the next, `(K - 1,)`.

    NaN from one drive to the next and, where signatures are per segment, to the next segment.
    """
    model, encoder = tensor_map.model, tensor_map.parameters.encoder
    stored = encoder.weighted(model.recorded)
    apart = model.segment_of_scan if encoder.per_segment else tensor_map.trajectory.drive_of_scan
    product = (stored[:-1].conj() * stored[1:]).sum(axis=(1, 2)).real
    norms = np.sqrt((np.abs(stored) ** 2).sum(axis=(1, 2)))
    norms = norms[:-1] * norms[1:]
    comparable = (norms > 0.0) & (np.diff(apart) == 0)
    cosines = np.divide(product, norms, out=np.full(len(norms), np.nan), where=comparable)
    return np.asarray(np.maximum(0.0, 1.0 - cosines))


@dataclass(frozen=True, eq=False)
class StationaryModel:
    """The changes of signatures of a stationary vehicle, from those between the map's scans.

    Attributes:
        threshold: A smaller change counts as stationary: the vehicle moved by less than half the
            distance between scans of the map, and by less than a metre.
        stopped: `(K,)` at which scans the mapping vehicle itself was stationary.
    """

    threshold: float
    stopped: BoolArray

    @classmethod
    def of_map(cls, tensor_map: TensorMap) -> "StationaryModel":
        """Return the model from consecutive scans of a map."""
        changes = changes_of_map(tensor_map)
        of_step = changes * _STEP_M / np.fmax(tensor_map.trajectory.steps_m, _STEP_M)
        known = _half_moving(of_step, tensor_map.trajectory.steps_m)
        threshold = _SHARE * float(np.quantile(known, _MOVING_QUANTILE)) if len(known) else 0.0
        small = np.concatenate([[False], np.nan_to_num(changes, nan=np.inf) < threshold, [False]])
        return cls(threshold, np.asarray(small[1:] | small[:-1]))

    def independence(self, changed: float | None) -> float:
        """Return how independent two observations of such a change are, 0..1.

        It is the change as a share of twice that over a step of the map, of 2 m at most; 0 where
        it is that of a stationary vehicle or nothing is known.
        """
        if changed is None or changed < self.threshold or not self.threshold:
            return 0.0
        return min(1.0, _SHARE * changed / (_INDEPENDENT * self.threshold))

    def likelihood(self, pace: FloatArray, *, stationary: bool) -> "PaceLikelihood":
        """Return the likelihood of a detection.

        A vehicle is stationary where it passes no scan of the map, or only scans at which the
        mapping vehicle was stationary: in maps without poses such scans follow each other.

        Args:
            pace: `(P,)`.
            stationary: Whether the vehicle was detected as stationary.
        """
        still = _STATIONARY_RATE if stationary else 1.0 - _MOVING_RATE
        of_pace = np.where(pace == 0.0, still, 1.0 - still)
        return PaceLikelihood(of_pace, still, self._stopped_places)

    @cached_property
    def _stopped_places(self) -> BoolArray:
        return np.repeat(self.stopped, 2)


def _half_moving(changes: FloatArray, steps_m: FloatArray) -> FloatArray:
    """Return the changes that are known, with at most as many of a vehicle that stood as others.

    By the poses: one that stood for ten minutes and drove for two has recorded little else.
    """
    known = np.isfinite(changes)
    stood = known & (steps_m < _STOOD_M)  # not where a pose is unknown
    moved = np.flatnonzero(known & ~stood)
    if not 0 < len(moved) < np.count_nonzero(stood):
        return np.asarray(changes[known])
    rows = np.concatenate([moved, spread_evenly(np.flatnonzero(stood), len(moved))])
    return np.asarray(changes[rows])


@dataclass(frozen=True, eq=False)
class PaceLikelihood:
    """The likelihood of a detection at each pace.

    Attributes:
        of_pace: `(P,)` at most places; that of all paces but 0 is the same.
        stopped: The likelihood at any pace, where the mapping vehicle was stationary.
        stopped_places: `(2K,)` at which places it was.
    """

    of_pace: FloatArray
    stopped: float
    stopped_places: BoolArray

    def at(self, places: IntArray) -> FloatArray:
        """Return the likelihood at some places and each pace, `(n, P)`."""
        return np.where(self.stopped_places[places, None], self.stopped, self.of_pace)

    @cached_property
    def still_or_moving(self) -> FloatArray:
        """The likelihood of each place at pace 0, and at all other paces, `(2, 2K)`."""
        found = np.empty((2, len(self.stopped_places)))
        found[0], found[1] = self.of_pace[0], self.of_pace[-1]
        found[:, self.stopped_places] = self.stopped
        return frozen(found, np.float64)


class StationaryDetector:
    """Detects a stationary vehicle: its signature stays near that of the place where it stopped.

    Args:
        model: The map's.
        resumed: Whether it continues a track, whose last observation is not known.

    Attributes:
        independence: How independent the last observation is of those before it, 0..1; 1 of the
            first one of a new track.
    """

    def __init__(self, model: StationaryModel, *, resumed: bool = False) -> None:
        self._model = model
        self._anchor: tuple[Signature, ...] = ()
        self._still = 0
        self._resumed = resumed
        self.independence = 0.0

    def update(self, signatures: Sequence[Signature]) -> bool:
        """Take the next observation's signatures, and return whether the vehicle is stationary."""
        is_first = not self._anchor and not self._resumed
        changed = change(self._anchor, signatures) if self._anchor else None
        self.independence = 1.0 if is_first else self._model.independence(changed)
        if changed is not None and changed < self._model.threshold:
            self._still += 1
        else:
            self._anchor, self._still = tuple(signatures), 0
        return self._still >= _FIRM
