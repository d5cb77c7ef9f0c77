"""Match signatures of full and of partial views with 3,800 scans of any views.

Of a dense sensor and of a sparse one, whose distances differ less. Bars: a full view about as long
as one plain product with all renderings and the waves of those that are compared exactly, 1 ms; a
partial one at most 4 times that.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.maps import localizer_of
from benchmarks.results import Row
from benchmarks.timing import medians_s
from core.arrays import Complex64Array
from core.encodings.harmonic.model import HarmonicModel
from core.encodings.search import Neighbours
from core.encodings.signature import Signature
from core.evaluation.condition import Condition
from core.parameters import MapParameters
from core.scans.sensor import sensor_named
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor

BAR_MS, MOST_PARTIAL = 1.0, 4.0
SCANS, QUERIES, ROUNDS = 3800, 8, 15
SENSORS = {
    "dense": SimulatedSensor(firings=360),
    "sparse": SimulatedSensor.of(sensor_named("vlp-16")),
}
PARTIAL = ("hidden:60", "hidden:120", "fov:120")
_COMPARED, _HEADINGS = 120, 128  # renderings in all headings, as in a match


def measure() -> list[Row]:
    """Return the rows."""
    threadpool_limits(limits=1)
    return [row for name, sensor in SENSORS.items() for row in _rows(name, sensor)]


def _rows(name: str, sensor: SimulatedSensor) -> list[Row]:
    drive = SimulatedDrive(seed=1, scans=2 * SCANS, loop_m=4000.0, sensor=sensor)
    localizer = localizer_of(drive, np.arange(0, 2 * SCANS, 2), MapParameters.for_sensor())
    model = localizer.map.model
    assert isinstance(model, HarmonicModel)  # noqa: S101 - for the reader and mypy
    renderings = np.ascontiguousarray(model.signatures.transpose(3, 2, 1, 0))
    renderings = renderings.reshape(*renderings.shape[:2], -1)
    product_ms: list[float] = []
    times_ms: dict[str, list[float]] = {}
    for index in range(1, 2 * SCANS, 2 * SCANS // QUERIES):
        for disturb in ("", *PARTIAL):
            scan = Condition(disturb=disturb).apply(
                drive.scan(index), np.random.default_rng([0, index])
            )
            signatures = localizer.basis.encode(localizer.basis.image(scan))
            [signature] = signatures
            match_s, product_s = medians_s(
                partial(_match, model, signatures),
                partial(_product, renderings, signature.values.astype(np.complex64)),
                ROUNDS,
            )
            times_ms.setdefault(disturb, []).append(1e3 * match_s)
            if not disturb:
                product_ms.append(1e3 * product_s)
    full_ms = float(np.median(times_ms[""]))
    unseen = np.mean(np.asarray(model.hidden_sectors) != 0)
    beside = f"one plain product {np.median(product_ms):.2f}; {unseen:.0%} of renderings partial"
    what = f"match among {SCANS} scans of any views, {name}"
    return [
        Row(f"{what}, full view, ms", full_ms, BAR_MS, beside, of_machine=True),
        *(
            Row(
                f"{what}, {disturb}, ms",
                float(np.median(times_ms[disturb])),
                MOST_PARTIAL * BAR_MS,
                f"{np.median(times_ms[disturb]) / full_ms:.1f} times the full view",
                of_machine=True,
            )
            for disturb in PARTIAL
        ),
    ]


def _match(model: HarmonicModel, signatures: Sequence[Signature]) -> Neighbours:
    return model.search(signatures).nearest(1)


def _product(renderings: Complex64Array, values: Complex64Array) -> object:
    """Multiply a signature with `(r2, r1, n)` renderings; find the headings of those compared."""
    r1, r2 = values.shape
    waves = [values[:, m] @ renderings[m, :r1] for m in range(r2)]
    return np.fft.irfft(np.stack([wave[:_COMPARED] for wave in waves], axis=-1), _HEADINGS, axis=-1)
