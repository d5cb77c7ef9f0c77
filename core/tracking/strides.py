"""Strides, the steps of travel: to the next scan, or about half a metre where scans are nearer."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from core.arrays import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    Steps = csr_array[np.float64, tuple[int, int]]

STRIDE_M = 0.5
"""The length of a stride where scans are nearer each other."""

_MOST_SCANS = 10  # of a stride; more scans on so short a way are a stand
_COUNT = np.arange(_MOST_SCANS)[:, None]  # less one


@dataclass(frozen=True, eq=False)
class Strides:
    """Where a stride leads from each of N places.

    The last stride of a way ends at each of the scans around its end: strides of five scans alone
    would lead to every fifth scan. Where scans are farther apart the two are the same.

    Attributes:
        ahead: `(N, N)`, the probability of a place (row) one stride after another (column); columns
            sum to 1.
        ahead_m: `(N,)` the length of that stride in metres, NaN where unknown, 0 where there is
            nothing ahead.
        last: `(N, N)`, the same of a way's last stride.
        last_m: `(N,)` its mean length.
        scans: `(N,)` how many scans a stride ahead passes.
    """

    ahead: "Steps"
    ahead_m: FloatArray
    last: "Steps"
    last_m: FloatArray
    scans: IntArray

    @classmethod
    def of_scans(cls, ahead: "Steps", step_m: FloatArray, drive_of_place: IntArray) -> "Strides":
        """Return the strides of a map.

        Where metres are unknown a stride passes as many scans as usual in that drive.

        Args:
            ahead: `(N, N)`, the probability of a place one scan after another; columns sum to 1.
            step_m: `(N,)` metres to the next scan ahead, NaN where unknown, 0 where there is none.
            drive_of_place: `(N,)`.
        """
        lengths_m = _lengths_ahead_m(ahead, step_m)
        # Behind the end of a street there is nothing: no number of scans leads farther.
        leads_on = _leads_on(ahead) & ~np.isnan(lengths_m)
        off_m = np.where(leads_on & (lengths_m > 0.0), np.abs(lengths_m - STRIDE_M), np.inf)
        nearest = off_m.argmin(axis=0)
        is_around = leads_on & (lengths_m > 0.5 * STRIDE_M) & (lengths_m <= 1.5 * STRIDE_M)
        # Scans at one place are as near as each other.
        is_around |= leads_on & (off_m == off_m.min(axis=0)) & ~is_around.any(axis=0)
        unknown = _are_unknown(nearest, lengths_m)
        usual = _usual(nearest, unknown, drive_of_place)
        nearest[unknown] = usual
        is_around[:, unknown] = np.abs(_COUNT - usual) <= (usual + 1) // 2
        scans = nearest + 1
        if not is_around[1:].any() and not nearest.any():
            return cls(ahead, step_m, ahead, step_m, scans)
        powers = [ahead]
        while len(powers) < _MOST_SCANS and is_around[len(powers) :].any():
            powers.append(ahead @ powers[-1])
        is_nearest = nearest == _COUNT
        return cls(
            *_mean(powers, lengths_m, is_nearest), *_mean(powers, lengths_m, is_around), scans
        )


def _lengths_ahead_m(ahead: "Steps", step_m: FloatArray) -> FloatArray:
    """Return the mean length of 1 to `_MOST_SCANS` scans from each place, `(n, N)`."""
    back, lengths_m = ahead.T.tocsr(), [step_m]
    for _ in range(_MOST_SCANS - 1):
        lengths_m.append(step_m + back @ lengths_m[-1])
    return np.array(lengths_m)


def _leads_on(ahead: "Steps") -> BoolArray:
    """Return whether each of 1 to `_MOST_SCANS` scans may lead farther than one less, `(n, N)`."""
    back, at_end = ahead.T.tocsr(), np.asarray(ahead.diagonal(), np.float64)
    leads_on = np.ones((_MOST_SCANS, len(at_end)), np.bool_)
    for count in range(1, _MOST_SCANS):
        at_end = np.asarray(back @ at_end)
        leads_on[count] = at_end < 1.0
    return leads_on


def _are_unknown(nearest: IntArray, lengths_m: FloatArray) -> BoolArray:
    """Return where metres are unknown before half a metre is reached, `(N,)`."""
    places, beyond = np.arange(len(nearest)), np.minimum(nearest + 1, _MOST_SCANS - 1)
    reached_m, next_m = lengths_m[nearest, places], lengths_m[beyond, places]
    return np.asarray(np.isnan(reached_m) | (np.isnan(next_m) & (reached_m < STRIDE_M)))


def _usual(nearest: IntArray, unknown: BoolArray, drive_of_place: IntArray) -> IntArray:
    """Return the usual number of the drive of each place where it is unknown, 0 without any."""
    usual = np.zeros(int(drive_of_place.max(initial=0)) + 1, np.int64)
    for drive in np.unique(drive_of_place[unknown]).tolist():
        known = nearest[(drive_of_place == drive) & ~unknown]
        usual[drive] = int(np.median(known)) if len(known) else 0
    return np.asarray(usual[drive_of_place[unknown]])


def _mean(
    powers: "list[Steps]", lengths_m: FloatArray, counts: BoolArray
) -> "tuple[Steps, FloatArray]":
    """Return the mean of the numbers of scans that count, `(n, N)`, and its length."""
    from scipy.sparse import diags_array  # only tracks need it: decision 33

    share = counts / counts.sum(axis=0)
    total = powers[0] @ diags_array(share[0])
    for power, of_power in zip(powers[1:], share[1:], strict=False):
        total = total + power @ diags_array(of_power)
    mean = total.tocsr()
    mean.eliminate_zeros()
    return mean, np.where(counts, share * lengths_m, 0.0).sum(axis=0)
