"""Search 1e3 to 1e6 scans of five renderings, beside reading the bytes that must be read.

    python -m benchmarks.large_maps [--plot docs/reference/large-maps.svg]

The bar is three times the reading. The maps are mixed (`benchmarks.mixed_maps`); times are CPU
milliseconds of the best match, one thread, the median of 40 known places; beside them the slowest,
the median of 20 unknown places, and NumPy without the extra `large-maps`.
"""

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.mixed_maps import City, MixedMap, read_bytes
from benchmarks.results import Row
from core.arrays import ComplexArray
from core.encodings.harmonic import in_phase
from core.encodings.harmonic.model import HarmonicModel
from core.projection.imager import Views

SCANS = (1_000, 10_000, 100_000, 1_000_000)
TIMES = 3.0
_KNOWN, _UNKNOWN, _BY_NUMPY, _READS = 40, 20, 10, 7
_ROUNDS = 3  # of which each query counts as it was fastest, as the reading does
_NEAR = 2  # scans, 3 m


@dataclass(frozen=True)
class Measurement:
    """Of one map.

    Attributes:
        views: The map's views.
        scans: How many it has.
        known_ms: The time of each query of a known place.
        unknown_ms: The time of each query of an unknown place.
        numpy_ms: The time of some queries of known places without a compiled loop.
        reading_ms: The time of reading the codes that are compared.
        megabytes: The size of these codes.
        recall: How many of the known places were found, 0..1.
    """

    views: Views
    scans: int
    known_ms: Sequence[float]
    unknown_ms: Sequence[float]
    numpy_ms: Sequence[float]
    reading_ms: float
    megabytes: float
    recall: float

    def row(self) -> Row:
        """Return the row of the table."""
        exact, unknown, by_numpy = (
            float(np.median(one)) for one in (self.known_ms, self.unknown_ms, self.numpy_ms)
        )
        beside = (
            f"reading {self.megabytes:.1f} MB {self.reading_ms:.3f}, slowest"
            f" {max(self.known_ms):.2f}, unknown places {unknown:.2f}, without numba"
            f" {by_numpy:.2f}; recall@1 {self.recall:.2f}"
        )
        name = f"best of {self.scans} scans, {self.views} views, ms"
        return Row(name, exact, TIMES * self.reading_ms, beside)


def measure() -> list[Row]:
    """Return the rows."""
    return [one.row() for one in _measurements()]


def main() -> int:
    """Print the rows, and draw them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plot", type=Path)
    given = parser.parse_args()
    found = []
    for one in _measurements():
        found.append(one)
        print(one.row().line("large_maps"), flush=True)
    if given.plot:
        _draw(found, given.plot)
    return 0


def _measurements() -> Iterator[Measurement]:
    threadpool_limits(limits=1)
    for views in Views.FULL, Views.ANY:
        city = City.simulated(views)
        for scans in SCANS:
            yield _measured(views, MixedMap.of(city, scans))


def _measured(views: Views, mixed: MixedMap) -> Measurement:
    model = mixed.model
    queries, wanted = mixed.queries(_KNOWN)
    _best(model, queries[0])  # its norms are kept, and the loop is compiled
    found = [_best(model, query) for query in queries]
    read = read_bytes(model, queries[0].shape)
    with _numpy_alone():
        by_numpy = _each_ms(model, queries[:_BY_NUMPY])
    return Measurement(
        views,
        len(model),
        _each_ms(model, queries),
        _each_ms(model, mixed.unknown(_UNKNOWN)),
        by_numpy,
        min(_ms(read.sum) for _ in range(_READS)),
        read.nbytes / 1e6,
        float(np.mean(np.abs(np.array(found) - wanted) <= _NEAR)),
    )


def _each_ms(model: HarmonicModel, queries: Sequence[ComplexArray]) -> list[float]:
    times = [[_ms(partial(_best, model, query)) for query in queries] for _ in range(_ROUNDS)]
    return [min(of_query) for of_query in zip(*times, strict=True)]


def _best(model: HarmonicModel, query: ComplexArray) -> int:
    return int(model.search_values(query).nearest(1).rows[0])


def _ms(function: Callable[[], object]) -> float:
    begun = time.thread_time()
    function()
    return 1e3 * (time.thread_time() - begun)


@contextmanager
def _numpy_alone() -> Iterator[None]:
    before = in_phase._LEAST_COMPILED
    in_phase._LEAST_COMPILED = sys.maxsize
    try:
        yield
    finally:
        in_phase._LEAST_COMPILED = before


def _draw(found: Sequence[Measurement], path: Path) -> None:
    import matplotlib as mpl
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    mpl.rcParams.update({"svg.hashsalt": "large maps", "svg.fonttype": "none", "font.size": 9})
    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    FigureCanvasSVG(figure)
    for axes, views in zip(
        figure.subplots(1, 2, sharey=True), (Views.FULL, Views.ANY), strict=True
    ):
        some = [one for one in found if one.views == views]
        scans = [one.scans for one in some]
        reading = np.array([one.reading_ms for one in some])
        axes.fill_between(scans, reading, TIMES * reading, color="0.9", label="up to 3 x reading")
        axes.loglog(scans, reading, "k-", label="reading")
        for label, marker, of in (
            ("exact, NumPy alone", "s", [one.numpy_ms for one in some]),
            ("exact, unknown places", "^", [one.unknown_ms for one in some]),
            ("exact", "o", [one.known_ms for one in some]),
        ):
            axes.loglog(scans, [np.median(one) for one in of], marker + "-", ms=4, label=label)
        axes.set(title=f"{views} views", xlabel="scans of five renderings")
        axes.grid(alpha=0.3)
        axes.legend(frameon=False)
    figure.axes[0].set_ylabel("ms of CPU")
    figure.savefig(path, format="svg", metadata={"Date": None})


if __name__ == "__main__":
    sys.exit(main())
