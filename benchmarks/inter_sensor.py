"""Recall@1 of a map by one sensor, queried by another: all pairs, in simulated cities.

    python -m benchmarks.inter_sensor [SEED ...] [--sensors NAME,...] [--methods NAME,...]

Each sensor records the same city twice on the same line, on the same mounting. One pass is the
map; the other, with other parked and moving cars and 1 m beside, has the queries. Right is a
matched scan within 3 m of the query's place; a query that cannot be described, or gets no answer,
is wrong. The answer is that of the method's own projection of the query's returns: the sensor is
not given to the map. A cell is the mean over the cities, on whose seeds nothing was
chosen.

Beams, fields of view and rays are those of the datasheets (docs/reference/sensors.md); range,
noise and dropouts are the same for all, those of the HDL-64E. So the table measures what
elevations, field of view and density do, and not how far a sensor reaches.
"""

import argparse
from collections.abc import Sequence
from functools import partial

import numpy as np
from threadpoolctl import threadpool_limits

from baselines.roster import methods_named
from benchmarks.accuracy import commit, print_table
from benchmarks.timing import machine
from core.arrays import FloatArray
from core.evaluation.condition import Condition
from core.evaluation.methods import Enrolled, Nearest
from core.evaluation.metrics import apart_m
from core.evaluation.query_set import QuerySet
from core.scans.scan import Scan
from core.scans.sensor import HDL_64E_ON_KITTI_HEIGHT_M, sensor_named
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor

SEEDS = (301, 302, 303)
SENSORS = ("hdl-64e", "vlp-16", "os1-64", "os0-128", "pandar64", "mid-360", "hap", "avia")
METHODS = ("harmonic", "scan-context", "solid")
SCANS = 300
QUERY_EVERY = 4
BESIDE_M = 1.0
WITHIN_M = 3.0


def main(seeds: Sequence[int], sensors: Sequence[str], methods: Sequence[str]) -> None:
    """Print a table for each method."""
    threadpool_limits(limits=1)
    print(f"Printed by `python -m benchmarks.inter_sensor` at {commit()} on {machine()}.")
    print(
        f"Cities {', '.join(map(str, seeds))}, {SCANS} scans each, every {QUERY_EVERY}-th queried."
    )
    found = np.mean([recalls(seed, sensors, methods) for seed in seeds], axis=0)
    for name, table in zip(methods, found, strict=True):
        print(f"\n## {name}\n")
        print_table(
            ["map \\ query", *sensors],
            [
                [sensor, *(f"{recall:.3f}" for recall in row)]
                for sensor, row in zip(sensors, table.tolist(), strict=True)
            ],
        )


def recalls(seed: int, sensors: Sequence[str], methods: Sequence[str]) -> FloatArray:
    """Return recall@1 in one city, `(methods, sensors of the map, sensors of the query)`."""
    mapped = {name: _pass(seed, name) for name in sensors}
    places = [
        [
            method.enrol(mapped[name], np.arange(SCANS))
            for method in methods_named(
                methods,
                sensor=name,
                sensor_height_m=HDL_64E_ON_KITTI_HEIGHT_M,
                segment_length=SCANS,
            )
        ]
        for name in sensors
    ]
    answering = [partial(_answer, enrolled) for of_map in places for enrolled in of_map]
    table = np.empty((len(sensors), len(methods), len(sensors)))
    for column, name in enumerate(sensors):
        queried = _pass(seed, name, second=True)
        scans = np.arange(0, SCANS, QUERY_EVERY)
        answers = QuerySet(queried, scans, (Condition(),), seed).answers(answering, "querying")
        true = queried.poses[scans]
        for row, of_one in enumerate(answers):
            matched = np.array([-1 if found is None else found for found in of_one[0]])
            apart = apart_m(mapped[name].poses[matched], true)
            right = (matched >= 0) & (apart <= WITHIN_M)
            table[row // len(methods), row % len(methods), column] = right.mean()
    return table.swapaxes(0, 1)


def _pass(seed: int, sensor: str, *, second: bool = False) -> SimulatedDrive:
    return SimulatedDrive(
        seed,
        SCANS,
        stops=False,
        traffic_seed=seed + 1000 * second,
        lateral_offset_m=BESIDE_M * second,
        sensor=SimulatedSensor.of(sensor_named(sensor)),
    )


def _answer(places: Enrolled, _query: int, scan: Scan) -> int:
    found: Nearest | None = places.describe(scan)(None)
    return -1 if found is None else int(places.scans[found.row])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("seeds", nargs="*", type=int, default=SEEDS, metavar="SEED")
    parser.add_argument("--sensors", default=",".join(SENSORS), metavar="NAME,...")
    parser.add_argument("--methods", default=",".join(METHODS), metavar="NAME,...")
    given = parser.parse_args()
    main(given.seeds, given.sensors.split(","), given.methods.split(","))
