"""A whole answer against the search in it, in the paper's encoding at L = 400.

Every segment has bases of its own, so whatever is done for each signature is done 400 times: the
answer to an image takes at most 1.5 times as long as projecting and comparing it. Signatures
were projected on board; comparing them takes a millisecond, so their times have no bar.
"""

import sys

import numpy as np

from benchmarks.maps import random_paper_map
from benchmarks.results import Row, show
from benchmarks.timing import medians_s
from core.localization.localizer import Localizer
from core.projection.imager import Image
from core.scans.sensor import AngularGrid

BAR = 1.5
SEGMENTS, SCANS_A_SEGMENT = 400, 20
RUNS = 31


def measure() -> list[Row]:
    """Return the row."""
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
    what = f"answer to an image, {SEGMENTS} segments of {SCANS_A_SEGMENT} scans, ms"
    beside = (
        f"of which the search {1e3 * search_s:.2f}; to its signatures {1e3 * signed_s:.2f}, of"
        f" which {1e3 * compared_s:.2f} compare them"
    )
    return [Row(what, 1e3 * answer_s, 1e3 * BAR * search_s, beside)]


if __name__ == "__main__":
    sys.exit(show(measure()))
