"""A whole answer against the search in it, in the paper's encoding at L = 400.

Every segment has bases of its own, so whatever is done for each signature is done 400 times. Bar:
the answer to an image takes at most 1.5 times as long as projecting and comparing it. Signatures
were projected on board; comparing them takes a millisecond, so their times have no bar.
"""

import sys

import numpy as np

from benchmarks.maps import random_paper_map
from benchmarks.timing import machine, medians_s
from core.localization.localizer import Localizer
from core.projection.imager import Image
from core.scans.sensor import AngularGrid

BAR = 1.5
SEGMENTS, SCANS_A_SEGMENT = 400, 20
RUNS = 31


def main() -> int:
    """Print the times; return 1 if an answer takes longer than the bar."""
    localizer = Localizer(random_paper_map(SEGMENTS, SCANS_A_SEGMENT, poses=True))
    model, basis = localizer.map.model, localizer.basis
    grid = AngularGrid()
    cells = np.random.default_rng(1).uniform(2.0, 60.0, grid.shape).astype(np.float32)
    image = Image(cells, grid)
    signatures = basis.encode(image)
    answer_s, search_s = medians_s(
        lambda: localizer.localize_image(image),
        lambda: model.search_values(basis.project(image)).nearest(1),
        RUNS,
    )
    signed_s, compared_s = medians_s(
        lambda: localizer.localize_signatures(signatures),
        lambda: model.search(signatures).nearest(1),
        RUNS,
    )
    ratio = answer_s / search_s
    print(
        f"answer to an image, {SEGMENTS} segments of {SCANS_A_SEGMENT} scans:"
        f" {1e3 * answer_s:.2f} ms, of which the search {1e3 * search_s:.2f} ms:"
        f" {ratio:.2f} times (bar {BAR:g}); to its signatures {1e3 * signed_s:.2f} ms, of which"
        f" {1e3 * compared_s:.2f} ms compare them; {machine()}"
    )
    return int(ratio > BAR)


if __name__ == "__main__":
    sys.exit(main())
