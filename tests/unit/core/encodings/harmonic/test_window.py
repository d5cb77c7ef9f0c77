import tracemalloc

import numpy as np

from core.encodings.harmonic.window import diagonal_sums, window_of
from core.projection.visibility import View


def sums_of(first, kept):
    """Return what the sums along diagonals are of one view of many, each computed for itself."""
    return diagonal_sums(window_of(View(tuple(range(first, first + 8))), 360, kept), kept)


def test_what_many_views_of_many_harmonics_need_is_not_all_kept():
    tracemalloc.start()
    needed = sum(sums_of(first, 60).nbytes for first in range(10))
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert needed > 128 * 2**20
    assert held < 66 * 2**20


def test_what_a_few_views_need_is_kept():
    for kept in (12, 60, 92):
        assert sums_of(3, kept) is sums_of(3, kept)
    few = [sums_of(first, 12) for first in range(50)]
    assert all(sums is sums_of(first, 12) for first, sums in enumerate(few))
    assert not np.array_equal(few[0], few[1])
