"""Find one range image among 3,800: by its signatures, and by comparing it with every image.

At least 20 times faster than the comparison with all images, one thread each.
"""

import sys

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.images import GeneratedImages
from benchmarks.results import Row, show
from benchmarks.timing import medians_s
from core.localization.localizer import Localizer
from core.mapping.fit import fit_map
from core.parameters import MapParameters
from core.projection.imager import Image
from core.scans.trajectory import Trajectory
from core.segmentation.fixed import PAPER_SEGMENT_LENGTH, cut_fixed

BAR = 1 / 20
SCANS = 3800


def measure() -> list[Row]:
    """Return the row."""
    threadpool_limits(limits=1)
    source = GeneratedImages(SCANS)
    every_image = source.read(0, SCANS)
    trajectory = Trajectory.of_drive(
        "generated",
        np.arange(SCANS, dtype=np.float64),
        np.full((SCANS, 7), np.nan),
        np.arange(SCANS),
    )
    cuts = cut_fixed(SCANS, PAPER_SEGMENT_LENGTH)
    localizer = Localizer(fit_map(source, trajectory, cuts, MapParameters()))
    query = Image(every_image[1234], source.grid)

    def by_images() -> int:
        squared = np.square(every_image - query.cells).sum(axis=(1, 2))
        return int(squared.argmin())

    assert localizer.localize_image(query).best.row == by_images() == 1234  # noqa: S101 - else the comparison is void
    our_s, their_s = medians_s(lambda: localizer.localize_image(query), by_images, runs=7)
    what, beside = f"localize among {SCANS} scans, ms", f"all images {1e3 * their_s:.0f}"
    return [Row(what, 1e3 * our_s, 1e3 * BAR * their_s, beside)]


if __name__ == "__main__":
    sys.exit(show(measure()))
