"""Verify the 25 best candidates of a scan among 3,800 scans of five renderings each.

At most 8 times a full-view match of a signature among the same scans; beside it, a whole
scan query of a map of any views.
"""

import sys
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.maps import localizer_of
from benchmarks.results import Row, show
from benchmarks.timing import medians_s
from core.arrays import IntArray
from core.encodings.harmonic.model import HarmonicModel
from core.encodings.harmonic.small_query import SmallQuery
from core.localization.localizer import Localizer
from core.parameters import MapParameters
from core.projection.imager import Image, Views
from core.projection.visibility import SECTORS
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor

BAR = 8.0
SCANS = 3800
CANDIDATES = 25
ROUNDS = 7


def measure() -> list[Row]:
    """Return the row."""
    threadpool_limits(limits=1)
    drive = SimulatedDrive(
        seed=1, scans=2 * SCANS, loop_m=4000.0, sensor=SimulatedSensor(firings=360)
    )
    mapped = np.arange(0, 2 * SCANS, 2)
    full, views = (
        localizer_of(drive, mapped, MapParameters.for_sensor(views=views)) for views in Views
    )
    times_s = np.median(
        [_times_s(drive, index, full, views) for index in range(1, 2 * SCANS, 2 * SCANS // 8)],
        axis=0,
    )
    match_ms, verify_ms, whole_ms = (1e3 * times_s).tolist()
    what = f"verification of {CANDIDATES} of {SCANS} scans, ms"
    beside = f"full-view match {match_ms:.2f}; whole scan query of any views {whole_ms:.1f}"
    return [Row(what, verify_ms, BAR * match_ms, beside)]


def _times_s(
    drive: SimulatedDrive, index: int, full: Localizer, views: Localizer
) -> Sequence[float]:
    scan = drive.scan(index)
    signatures = full.basis.encode(full.basis.image(scan))
    image = views.basis.image(scan)
    match_s, verify_s = medians_s(
        lambda: full.map.model.search(signatures).nearest(1), _verification(views, image), ROUNDS
    )
    whole_s, _ = medians_s(
        lambda: views.map.model.search_image(image, views.basis).nearest(1), lambda: None, ROUNDS
    )
    return match_s, verify_s, whole_s


def _verification(localizer: Localizer, image: Image) -> Callable[[], object]:
    """Return the cell by cell comparison of a query with its candidates, without a search."""
    model = localizer.map.model
    assert isinstance(model, HarmonicModel)  # noqa: S101 - for the reader and mypy
    found = model.search_image(image, localizer.basis).nearest(CANDIDATES)
    sectors = np.rint(found.relative_yaw_deg * SECTORS / 360.0).astype(np.int64)
    headings = (sectors[:, None] + np.arange(-1, 2)) % SECTORS
    return partial(_verify, model, image, found.rows, headings)


def _verify(model: HarmonicModel, image: Image, rows: IntArray, headings: IntArray) -> object:
    views = model.beside.of(model.small_images(rows))
    return SmallQuery(image.cells).correlation(views, model.seen_on_line(rows), headings)


if __name__ == "__main__":
    sys.exit(show(measure()))
