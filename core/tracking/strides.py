"""Strides, the steps of travel: to the next scan, or about half a metre where scans are nearer."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from core.arrays import BoolArray, FloatArray

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    Steps = csr_array[np.float64, tuple[int, int]]

STRIDE_M = 0.5
"""The length of a stride where scans are nearer each other."""

_MOST_SCANS = 10  # of a stride; more scans on so short a way are a stand


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
    """

    ahead: "Steps"
    ahead_m: FloatArray
    last: "Steps"
    last_m: FloatArray

    @classmethod
    def of_scans(cls, ahead: "Steps", step_m: FloatArray) -> "Strides":
        """Return the strides of a map.

        Args:
            ahead: `(N, N)`, the probability of a place one scan after another; columns sum to 1.
            step_m: `(N,)` metres to the next scan ahead, NaN where unknown, 0 where there is none.
        """
        back, length_m = ahead.T.tocsr(), [step_m]
        for _ in range(_MOST_SCANS - 1):
            length_m.append(step_m + back @ length_m[-1])
        lengths_m = np.array(length_m)
        # Of several numbers of scans that are as long the first one: nothing is ahead of it.
        longer_m = np.where(np.diff(lengths_m, axis=0) > 0.0, lengths_m[1:], np.inf)
        reached_m = np.concatenate([np.nan_to_num(lengths_m[:1], nan=np.inf), longer_m])
        nearest = np.abs(reached_m - STRIDE_M).argmin(axis=0)
        is_nearest = np.arange(_MOST_SCANS)[:, None] == nearest
        is_around = (reached_m > 0.5 * STRIDE_M) & (reached_m <= 1.5 * STRIDE_M)
        is_around |= is_nearest & ~is_around.any(axis=0)
        if not is_around[1:].any() and not nearest.any():
            return cls(ahead, step_m, ahead, step_m)
        powers = [ahead]
        while len(powers) < _MOST_SCANS and is_around[len(powers) :].any():
            powers.append(ahead @ powers[-1])
        return cls(*_mean(powers, lengths_m, is_nearest), *_mean(powers, lengths_m, is_around))


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
