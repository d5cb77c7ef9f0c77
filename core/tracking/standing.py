"""Whether a vehicle stands, told by its signatures alone: no pose, no clock, no ground truth."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from core.arrays import BoolArray, FloatArray
from core.encodings.registry import encoding_named
from core.encodings.signature import Signature
from core.mapping.tensormap import TensorMap

_MOVING_QUANTILE = 0.75  # of the map's own changes: a map whose vehicle mostly drove, or half of it
_SHARE = 0.4  # of that, less than half a scan's way of the map: standing
_STANDING_TOLD = 0.9  # how often standing is told of a vehicle that stands
_MOVING_TOLD = 0.7  # how often moving is told of one that moves: a slow one seems to stand
_FIRM = 2  # changes in a row before standing is believed


def change(before: Sequence[Signature], after: Sequence[Signature]) -> float | None:
    """Return how much signatures changed, 1 - <g, h> / (|g| |h|), as they lie: a turn is a change.

    `None` if they have no segment in common or one is zero.
    """
    earlier = {s.segment: s.values for s in before}
    product = one = other = 0.0
    for signature in after:
        if (was := earlier.get(signature.segment)) is None:
            continue
        encoding = encoding_named(signature.encoding)
        weighted = encoding.weighted(was), encoding.weighted(signature.values)
        product += float(np.vdot(*weighted).real)
        one += float(np.vdot(weighted[0], weighted[0]).real)
        other += float(np.vdot(weighted[1], weighted[1]).real)
    if one <= 0.0 or other <= 0.0:
        return None
    return max(0.0, 1.0 - product / float(np.sqrt(one * other)))


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
    told = (norms > 0.0) & (np.diff(apart) == 0)
    changes = np.full(len(norms), np.nan)
    changes[told] = np.maximum(0.0, 1.0 - product[told] / norms[told])
    return changes


@dataclass(frozen=True, eq=False)
class Standing:
    """Tells standing by what moving changes in the map.

    Attributes:
        threshold: A smaller change than this is standing.
        stretch: `(K,)` at which scans the mapping vehicle itself stood.
    """

    threshold: float
    stretch: BoolArray

    @classmethod
    def of_map(cls, tensor_map: TensorMap) -> "Standing":
        """Learn it from consecutive scans of the map."""
        changes = changes_of_map(tensor_map)
        known = changes[np.isfinite(changes)]
        threshold = _SHARE * float(np.quantile(known, _MOVING_QUANTILE)) if len(known) else 0.0
        small = np.concatenate([[False], np.nan_to_num(changes, nan=np.inf) < threshold, [False]])
        return cls(threshold, np.asarray(small[1:] | small[:-1]))

    def likelihood(self, pace: FloatArray, *, standing: bool) -> FloatArray:
        """Return how likely that is told of each place and pace, `(2K, P)`.

        A vehicle stands where it passes no scan of the map, or scans that were recorded standing.
        """
        still = np.repeat(self.stretch, 2)[:, None] | (pace == 0.0)
        if standing:
            return np.where(still, _STANDING_TOLD, 1.0 - _STANDING_TOLD)
        return np.where(still, 1.0 - _MOVING_TOLD, _MOVING_TOLD)


class StandingDetector:
    """Follows one vehicle: it stands while its signature stays near that of where it stopped."""

    def __init__(self, standing: Standing) -> None:
        self._standing = standing
        self._anchor: tuple[Signature, ...] = ()
        self._still = 0

    def update(self, signatures: Sequence[Signature]) -> bool:
        """Take the next observation's signatures, and return whether the vehicle stands."""
        changed = change(self._anchor, signatures) if self._anchor else None
        if changed is not None and changed < self._standing.threshold:
            self._still += 1
        else:
            self._anchor, self._still = tuple(signatures), 0
        return self._still >= _FIRM
