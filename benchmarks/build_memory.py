"""Build a map of 100,000 generated range images, k = 760, and look at the process's memory.

The process that builds peaks below 200 MB; the images alone would be 4.3 GB.
"""

import resource
import sys
import time

import numpy as np

from app.process import keep_freed_memory, one_blas_thread
from benchmarks.images import GeneratedImages
from benchmarks.results import Row, show
from core.mapping.fit import fit_map
from core.parameters import MapParameters
from core.scans.trajectory import Trajectory
from core.segmentation.fixed import PAPER_SEGMENT_LENGTH, cut_fixed

BAR_MB = 200.0
SCANS = 100_000


def measure() -> list[Row]:
    """Return the row; of a process of its own."""
    one_blas_thread()
    keep_freed_memory()  # as every process that builds
    images = GeneratedImages(SCANS)
    trajectory = Trajectory.of_drive(
        "generated",
        np.arange(SCANS, dtype=np.float64),
        np.full((SCANS, 7), np.nan),
        np.arange(SCANS, dtype=np.int64),
    )
    begun = time.perf_counter()
    tensor_map = fit_map(
        images, trajectory, cut_fixed(SCANS, PAPER_SEGMENT_LENGTH), MapParameters()
    )
    seconds = time.perf_counter() - begun
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
    what = f"peak of building {SCANS} images in {tensor_map.model.segments} segments, MB"
    return [Row(what, peak_mb, BAR_MB, f"all images 4300; {seconds:.0f} s")]


if __name__ == "__main__":
    sys.exit(show(measure()))
