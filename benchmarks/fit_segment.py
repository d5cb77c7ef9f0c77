"""Fit one segment of the paper's size, 30 x 361 x 760, against TensorLy's partial_tucker.

Bar: at least 20 times faster with `n_iter_max=0` (the HO-SVD), same dtype, one thread each.
"""

import sys

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.images import GeneratedImages
from benchmarks.timing import machine, medians_s
from core.encodings.tucker import Grams, leading_basis, project, relative_error

BAR = 20.0
RANKS = (5, 5)
SCANS = 760


def main() -> int:
    """Print the ratios; return 1 if one is below the bar."""
    from tensorly.decomposition import partial_tucker  # a development dependency, slow to import

    threadpool_limits(limits=1)
    missed = 0
    print(f"fit 30 x 361 x {SCANS}, ranks {RANKS}, one thread; {machine()}")
    for dtype in (np.float32, np.float64):
        images = GeneratedImages(SCANS).read(0, SCANS).astype(dtype)
        tensor = np.ascontiguousarray(images.transpose(1, 2, 0))

        def ours(images: np.ndarray = images) -> float:
            grams = Grams.of(images)
            u = leading_basis(grams.elevation, RANKS[0])
            v = leading_basis(grams.azimuth, RANKS[1])
            return relative_error(grams.squared_norm, project(images, u, v))

        def theirs(tensor: np.ndarray = tensor) -> object:
            return partial_tucker(tensor, rank=list(RANKS), modes=[0, 1], n_iter_max=0)

        our_s, their_s = medians_s(ours, theirs, runs=7)
        ratio = their_s / our_s
        missed += ratio < BAR
        print(
            f"  {np.dtype(dtype).name}: {our_s:.3f} s, TensorLy {their_s:.2f} s:"
            f" {ratio:.1f} times faster (bar {BAR:g})"
        )
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
