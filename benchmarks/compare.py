"""The tables of docs/reference/comparison.md, from recorded and simulated drives.

    python -m benchmarks.compare DRIVES > docs/reference/comparison.md
    python -m benchmarks.compare DRIVES head|kitti00|conditions|muehlburger|cities|loops

DRIVES is a folder of drives in the KITTI odometry layout that holds `kitti00` and
`kit_muehlburger`. Nothing was chosen on the simulated cities' seeds. `map-closures` takes part in
`kitti00` where its package is installed.
"""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from threadpoolctl import threadpool_limits

from app.provenance import commit, machine, provenance
from baselines.roster import BY_SCAN, METHODS, default_methods, methods_named
from benchmarks.accuracy import described, print_table
from benchmarks.drives import in_memory
from benchmarks.maps import Once
from core.evaluation.compare import (
    Comparison,
    ComparisonProtocol,
    MethodResult,
    MethodUnderCondition,
    compare,
)
from core.evaluation.condition import Condition, conditions
from core.evaluation.methods import Method
from core.evaluation.pairing import HeldOut, LoopClosing, SecondPass
from core.evaluation.split import Every
from core.projection.imager import Views
from core.scans.drive import Drive
from core.scans.sensor import HDL_64E
from core.simulation import SimulatedDrive
from storage.formats.drives.layouts import open_drive

SEEDS = (101, 102, 103)
SCANS = 300
QUERY_EVERY = 10  # of a second pass: its neighbours, 0.1 s apart, add little
SEGMENTS = 5
PASSES = ((2.0, False), (2.0, True), (3.0, False), (3.0, True))

CONDITIONS: tuple[Condition, ...] = (
    *conditions((0, 10, 90, 180), (0,), (0,)),
    *conditions((0,), (1, -1, 2, -2, 2.25, -2.25, 3, -3), (0,)),
    *conditions((180,), (3, -3), (0,)),
    *conditions((0,), (0,), (0.5, 1.0)),
)
HALF = HeldOut(Every(2))
SINGLE = (*BY_SCAN, *METHODS[:-1])
"""All but map-closures, which is made for maps of many scans."""


def main(folder: Path, part: str = "") -> None:
    """Print the page, or one part of it."""
    threadpool_limits(limits=1)
    parts: dict[str, Callable[[], None]] = {
        "head": _head,
        "kitti00": lambda: _kitti00(folder),
        "conditions": lambda: _conditions(folder),
        "muehlburger": lambda: _muehlburger(folder),
        "cities": _cities,
        "loops": _loops,
    }
    for name, print_part in parts.items():
        if part in {"", name}:
            print_part()


def _head() -> None:
    of = provenance()
    print("# Comparison with other methods\n")
    print("Results of our encodings and the baselines on the same scans; printed by\n")
    print("```text\npython -m benchmarks.compare DRIVES\n```\n")
    print(f"at commit {commit()} on {machine()}, one thread, Python {of['python']}, NumPy")
    print(f"{of['numpy']}. `tensormap compare` prints the same figures for your own drives:")
    print("[Compare methods](../how-to/compare-methods.md). How the baselines were re-derived:")
    print("[Baselines](baselines.md).\n")
    print("- **R@1** within so many metres: of the queries that have a place within that distance,")
    print("  the share whose best match is one. **F1**: the maximum over all thresholds of the")
    print("  score, the negated distance. **AP**: average precision, the area under precision over")
    print("  recall as a sum of steps. **AUROC**: findable queries against those of another drive.")
    print("  **Yaw error**: median of the right answers' headings.")
    print("- **Bytes sent**: what a vehicle sends; ours packed (the paper's encoding one signature")
    print("  for each segment), the baselines' numbers as float32. **Bytes kept**: arrays per")
    print("  place, bases included. **ms**: medians of processor time from returns to descriptor")
    print("  and from descriptor to answer.")
    print("- `map-closures` describes and matches in one call. It is made for maps of many scans;")
    print("  here it gets single scans like all methods, leaves most queries unanswered, and is")
    print("  therefore in the first table only.")
    print(
        "- `harmonic` and `harmonic-scan` are of one map of any views, queried with signatures and"
    )
    print("  with whole scans. Under disturbances: [Partial views](partial-views.md).\n")
    print("Configuration: every method's defaults, five segments.\n")
    names: dict[str, list[str]] = {}
    for one in methods_named(
        default_methods(Views.ANY),
        sensor=HDL_64E.name,
        sensor_height_m=1.73,
        segment_length=SCANS,
    ):
        names.setdefault(_described_parameters(one), []).append(f"`{one.name}`")
    rows = [[", ".join(those), described] for described, those in names.items()]
    print_table(["method", "configuration"], rows)


def _described_parameters(one: Method) -> str:
    chosen = {k: v for k, v in one.configuration().items() if k != "segment_length"}
    return ", ".join(f"{name} {value}" for name, value in chosen.items())


def _methods(drive: Drive, names: Sequence[str]) -> tuple[Method, ...]:
    return methods_named(
        names,
        sensor=HDL_64E.name,
        sensor_height_m=1.73,
        segment_length=-(-len(drive) // SEGMENTS),
    )


def _kitti00(folder: Path) -> None:
    print("## `kitti00`, as driven\n")
    print("Recorded, 250 scans of an HDL-64E: even scans are places, odd ones queries. Unknown")
    print(f"places: `kit_muehlburger`, every {QUERY_EVERY}th scan.\n")
    drive = open_drive(folder / "kitti00", min_returns=100)
    unknown = open_drive(folder / "kit_muehlburger", min_returns=100)
    protocol = ComparisonProtocol(HALF, unknown_every=QUERY_EVERY)
    every = _methods(drive, default_methods(Views.ANY))
    _print_means([compare(drive, every, protocol, unknown_drive=unknown)], 3.0)


def _conditions(folder: Path) -> None:
    print("## `kitti00`, relative yaw, lateral offset, noise\n")
    print("R@1 within 3 m of where the query was recorded; the vehicle has another yaw and is to")
    print("the left of its scan (its returns are moved, nothing new is seen), or every coordinate")
    print("has noise. M2DP centres returns: moved ones are the same to it; only a real second pass")
    print("(below) tests it.\n")
    drive = open_drive(folder / "kitti00", min_returns=100)
    found = compare(drive, _methods(drive, SINGLE), ComparisonProtocol(HALF, conditions=CONDITIONS))
    _print_conditions(found)


def _muehlburger(folder: Path) -> None:
    print("## `kit_muehlburger`\n")
    print("Recorded, 501 scans at 10 Hz, the first 188 while standing; even scans are places.\n")
    drive = open_drive(folder / "kit_muehlburger", min_returns=100)
    found = compare(drive, _methods(drive, SINGLE), ComparisonProtocol(HALF))
    _print_means([found], 3.0)


def _cities() -> None:
    print("## Simulated cities, second passes\n")
    print(
        f"R@1 within 5 m: {SCANS} scans are places; a second pass really drives beside their line,"
    )
    print(
        'in its direction and in the opposite one ("against"), among other parked cars;'
        f" every {QUERY_EVERY}th scan is a query.\n"
    )
    rows, found = [], []
    for seed in SEEDS:
        city = in_memory(SimulatedDrive(seed=seed, scans=SCANS))
        other = in_memory(SimulatedDrive(seed=seed + 100, scans=SCANS), QUERY_EVERY)
        methods = [Once(one) for one in _methods(city, SINGLE)]
        for number, (offset_m, reverse) in enumerate(PASSES):
            second = SimulatedDrive(
                seed=seed,
                scans=SCANS,
                lateral_offset_m=offset_m,
                reverse=reverse,
                traffic_seed=seed + 1000,
            )
            queried = in_memory(second, QUERY_EVERY)
            unknown = None if number else other
            result = compare(city, methods, ComparisonProtocol(SecondPass()), queried, unknown)
            found.append(result)
            rows.append(
                [
                    f"{seed}, {offset_m:g} m{', against' if reverse else ''}",
                    *(
                        _figure(method.conditions[0].recall_at_1[5.0], ".3f")
                        for method in result.methods
                    ),
                ]
            )
    print_table(["seed, offset", *(f"`{name}`" for name in SINGLE)], rows)
    print(
        "Means over these passes; the AUROC is of the first of each seed, against another city.\n"
    )
    _print_means(found, 5.0)


def _loops() -> None:
    print("## Simulated cities, closing loops\n")
    print(f"One drive of {SCANS} scans that returns to its start; each scan is a query among")
    print("those at least 50 before it. Means over the seeds")
    print(f"{', '.join(map(str, SEEDS))}; our bases are fitted to the whole drive.\n")
    found = []
    for seed in SEEDS:
        drive = in_memory(SimulatedDrive(seed=seed, scans=SCANS))
        methods = _methods(drive, SINGLE)
        found.append(compare(drive, methods, ComparisonProtocol(LoopClosing(recent_scans=50))))
    queried = [result.methods[0].conditions[0] for result in found]
    of = ", ".join(f"{row.findable[3.0]} of {row.queries}" for row in queried)
    print(f"Findable within 3 m: {of} queries.\n")
    _print_means(found, 3.0)


def _print_conditions(result: Comparison) -> None:
    rows = [
        [
            described(of_first.condition),
            *(
                _figure(method.conditions[column].recall_at_1[3.0], ".3f")
                for method in result.methods
            ),
        ]
        for column, of_first in enumerate(result.methods[0].conditions)
    ]
    print_table(["query", *(f"`{method.name}`" for method in result.methods)], rows)


def _print_means(found: Sequence[Comparison], metres: float) -> None:
    rows = []
    for index, method in enumerate(found[0].methods):
        every = [result.methods[index].conditions[0] for result in found]
        rows.append(_row(method, every, metres))
    print_table(_columns(metres), rows)


def _columns(metres: float) -> list[str]:
    return [
        "method", "R@1 3 m", "5 m", "10 m", f"F1 {metres:g} m", f"AP {metres:g} m", "AUROC",
        "yaw error deg", "bytes sent", "bytes kept", "ms describe", "ms match", "unanswered",
    ]  # fmt: skip


def _row(
    method: MethodResult, conditions: Sequence[MethodUnderCondition], metres: float
) -> list[str]:
    def mean(values: Sequence[float | None]) -> float | None:
        known = [value for value in values if value is not None]
        return sum(known) / len(known) if known else None

    return [
        f"`{method.name}`",
        *(_figure(mean([c.recall_at_1[m] for c in conditions]), ".3f") for m in (3.0, 5.0, 10.0)),
        _figure(mean([c.max_f1[metres] for c in conditions]), ".3f"),
        _figure(mean([c.average_precision[metres] for c in conditions]), ".3f"),
        _figure(mean([c.novelty_auroc for c in conditions]), ".3f"),
        _figure(mean([c.heading_error_deg_median for c in conditions]), ".1f"),
        _figure(method.sent_bytes, ".0f"),
        _figure(method.stored_bytes, ".0f"),
        _figure(mean([c.describe_ms_median for c in conditions]), ".1f"),
        _figure(mean([c.match_ms_median for c in conditions]), ".2f"),
        str(sum(c.unanswered + c.refusals for c in conditions)),
    ]


def _figure(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
