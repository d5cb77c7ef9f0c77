"""What the distances of one observation say about where it was made."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from core.arrays import FloatArray
from core.confidence.places import away_from
from core.encodings.signature import Signature
from core.mapping.tensormap import TensorMap

_SAMPLED = 32  # scans of the map that are compared with all others
_RARE = 0.1  # quantile: a tenth of the map's scans have one elsewhere that is as near
_RESOLVED = 0.5  # of what one scan changes to the next
_FAR = 10.0
_TINY = 1e-6
_SLOPE = 4.0  # twice as far from the query is 16 times less likely
_MOST = 8.0  # nats: no single observation decides alone, whatever it says


class LikelihoodRatio(Protocol):
    """How distances tell a query's own place from others; a map's calibration is one."""

    def log_likelihood_ratio(self, distances: FloatArray) -> FloatArray:
        """Return log p(d | at this scan) - log p(d | elsewhere), of any shape."""


@dataclass(frozen=True)
class DistanceSpread:
    """How distances spread in a map: what is known without a calibration.

    A query from elsewhere has a nearest scan too. How near that is, the map tells by its own scans:
    the nearest one to each of them that was recorded elsewhere.

    Attributes:
        resolution: What a scan of the map changes to the next, halved; above 0. Differences below
            it tell little.
        even: The distance that speaks for this scan as much as for elsewhere, above 0.
    """

    resolution: float
    even: float

    def log_likelihood_ratio(self, distances: FloatArray) -> FloatArray:
        """Return a ratio that falls with a power of the distance and is 0 at `even`."""
        return np.asarray(_SLOPE * np.log(self.even / np.maximum(distances, _TINY * self.even)))

    @classmethod
    def of_map(cls, tensor_map: TensorMap) -> "DistanceSpread":
        """Learn it from the map's own signatures, some of them against all."""
        rows = np.unique(np.linspace(0, len(tensor_map) - 1, _SAMPLED).astype(np.int64))
        drive, segment = tensor_map.trajectory.drive_of_scan, tensor_map.model.segment_of_scan
        elsewhere: list[float] = []
        steps: list[float] = []
        model = tensor_map.model
        queries = model.own_queries(rows.tolist(), tensor_map.revision)
        for row, signatures in zip(rows.tolist(), queries, strict=True):
            distances = model.search(signatures).distances()
            away = away_from(tensor_map.trajectory, row)
            elsewhere.append(float(distances[away].min(initial=np.inf)))
            after = row + 1
            # Signatures of two segments may not compare.
            if (
                after < len(tensor_map)
                and drive[after] == drive[row]
                and segment[after] == segment[row]
            ):
                steps.append(float(distances[after]))
        nearest = [distance for distance in elsewhere if 0.0 < distance < np.inf]
        changes = [distance for distance in steps if 0.0 < distance < np.inf]
        if not nearest:  # one place only: nothing tells how far elsewhere is
            even = _FAR * (float(np.median(changes)) if changes else 1.0)
        else:
            even = float(np.quantile(nearest, _RARE))
        resolution = _RESOLVED * float(np.median(changes)) if changes else even
        return cls(min(resolution, even), even)


@dataclass(frozen=True)
class Emission:
    """The likelihood of an observation at each scan of the map, and outside of it.

    Whether the vehicle is on the map at all is told by the calibrated ratio of the nearest scan,
    less what it is for the nearest of all scans elsewhere: it is of one scan, and the nearest of
    thousands is near by chance.
    Which scan it is is told by the distances relative to the nearest one, more cautiously:
    consecutive observations err alike, and what is finer than the map's own scans tells little.

    Attributes:
        ratio: The map's calibration, or `spread`.
        spread: Of the map's own distances.
    """

    ratio: LikelihoodRatio
    spread: DistanceSpread

    def likelihood(self, distances: FloatArray) -> FloatArray:
        """Return the likelihood at each scan, `(K,)`; that of being elsewhere is 1.

        Args:
            distances: `(K,)`, infinite for scans that were not compared.
        """
        compared = np.isfinite(distances)
        if not compared.any():
            return np.ones(len(distances))
        nearest = float(distances[compared].min())
        resolution = self.spread.resolution
        told, usual = self.ratio.log_likelihood_ratio(np.array([nearest, self.spread.even]))
        on_map = float(told - usual)
        relative = np.full(len(distances), -_MOST)
        relative[compared] = -_SLOPE * np.log(
            (distances[compared] + resolution) / (nearest + resolution)
        )
        return np.asarray(np.exp(np.clip(on_map, -_MOST, _MOST) + np.maximum(relative, -_MOST)))

    @classmethod
    def of_map(cls, tensor_map: TensorMap) -> "Emission":
        """Return the emission of a map, by its calibration where it has one."""
        spread = DistanceSpread.of_map(tensor_map)
        return cls(tensor_map.calibration or spread, spread)


def own_signatures(tensor_map: TensorMap, row: int) -> tuple[Signature, ...]:
    """Return the signatures that a query at scan `row` would send, as far as the map has them."""
    return next(tensor_map.model.own_queries([row], tensor_map.revision))
