"""The first tables of docs/reference/tracking-measurements.md; fails where a bar is missed.

    python -m benchmarks.tracking DRIVES [recorded|cities]

DRIVES is a folder of drives in the KITTI odometry layout that holds `kit_muehlburger`. The
simulated cities have seeds on which nothing was chosen.
"""

import sys
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from benchmarks.accuracy import commit, print_table
from benchmarks.timing import machine
from core.evaluation.evaluate import Evaluation, EvaluationProtocol, evaluate
from core.evaluation.split import Interleaved
from core.evaluation.tracks import TrackResult
from core.parameters import MapParameters
from core.scans.drive import Drive
from core.scans.scan import Scan
from core.simulation import SimulatedDrive
from storage.formats.drives.layouts import open_drive

SEEDS = (301, 302, 303)
LENGTHS = (50, 100, 167)
CITY_SCANS, CITY_LOOP_M = 300, 480.0  # longer than the drive: no street is passed twice
QUERY_EVERY = 2
RECALL_BAR = 0.98  # share within 10 m of what is reported


def main(folder: Path, only: str = "") -> int:
    """Print the tables, and return how many bars were missed."""
    threadpool_limits(limits=1)
    print(f"At commit {commit()}, on {machine()}.\n", flush=True)
    missed: list[str] = []
    if only in {"", "recorded"}:
        missed += _recorded(open_drive(folder / "kit_muehlburger", min_returns=100))
    if only in {"", "cities"}:
        missed += _cities()
    for bar in missed:
        print(f"missed: {bar}")
    return len(missed)


def _recorded(drive: Drive) -> list[str]:
    print("### `kit_muehlburger`\n")
    print("Held-out scans as one drive: wrong segments reported, stationary + moving, of how many")
    print("were reported, of how many observations; how many were not reported and would have been")
    print("wrong; in brackets wrong segments of single localizations.\n")
    missed = []
    rows = []
    for encoding in ("harmonic", "paper"):
        for length in LENGTHS:
            cells = []
            for phase in range(5):
                found = evaluate(
                    drive,
                    EvaluationProtocol(
                        MapParameters.for_sensor(encoding=encoding),
                        segment_length=length,
                        split=Interleaved(0.2, phase),
                        track=True,
                    ),
                )
                track, alone = found.tracks[0], found.conditions[0]
                cells.append(
                    f"{track.errors_stationary} + {track.errors_moving}"
                    f" of {track.segments_reported} of {track.observations}, {track.unsure_wrong}"
                    f" ({alone.errors_stationary} + {alone.errors_moving})"
                )
                if encoding == "harmonic" and track.errors:
                    missed.append(f"{length}, phase {phase}: {track.errors}")
            rows.append([f"{encoding}, k = {length}", *cells])
    print_table(["", *(f"phase {phase}" for phase in range(5))], rows)
    return missed


def _cities() -> list[str]:
    print("### Simulated cities\n")
    print("A second pass with stops, other cars, every second scan queried; the next seed's city")
    print(
        "as one that is not mapped. Of what was reported: wrong segments, recall, position error.\n"
    )
    rows, missed = [], []
    for seed in SEEDS:
        passes = {
            "2 m left": _Pass(seed, QUERY_EVERY, lateral_offset_m=2.0, traffic_seed=seed + 1000),
            "2 m left, against": _Pass(
                seed, QUERY_EVERY, lateral_offset_m=2.0, reverse=True, traffic_seed=seed + 2000
            ),
        }
        for name, query in passes.items():
            track = _tracked(_Pass(seed), query).tracks[0]
            rows.append([f"{seed}, {name}", *_cells(track)])
            recall = track.recall_at_1[10.0]
            if recall is None or recall < RECALL_BAR:
                missed.append(f"{seed}, {name}: recall within 10 m is {recall}")
            if None in track.recovery:  # not found within 30 observations
                missed.append(f"{seed}, {name}: kidnapped and lost, {track.recovery}")
        other = _tracked(_Pass(seed), _Pass(_next(seed), QUERY_EVERY)).tracks[0]
        rows.append([f"{seed}, another city", *_cells(other)])
        if other.localized:
            missed.append(f"{seed}: another city was localized {other.localized} times")
    print_table(
        [
            "city",
            "reported of observed",
            "first fix",
            "wrong segments",
            "recall 3 / 5 / 10 m",
            "position error m",
            "standing detected / false",
            "flicker",
            "scans until recovery",
            "ms",
        ],
        rows,
    )
    return missed


def _next(seed: int) -> int:
    seeds = (*SEEDS, SEEDS[0] + 50)
    return seeds[seeds.index(seed) + 1]


def _cells(track: TrackResult) -> list[str]:
    recovery = [scans for scans in track.recovery if scans is not None]
    return [
        f"{track.localized} of {track.observations}",
        str(track.first_fix or "none"),
        f"{len(track.errors)} of {track.segments_reported}",
        " / ".join("-" if v is None else f"{v:.3f}" for v in track.recall_at_1.values()),
        _figure(track.position_error_m_median),
        f"{_figure(track.standing_found)} / {_figure(track.standing_false)}",
        str(track.flicker),
        f"{min(recovery)} to {max(recovery)}" if recovery else "-",
        _figure(track.ms_per_observation),
    ]


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


class _Pass:
    """A simulated drive of which only some scans are queried; cast when they are."""

    def __init__(self, seed: int, every: int = 1, **options: Any) -> None:  # noqa: ANN401
        self._drive = SimulatedDrive(seed=seed, scans=CITY_SCANS, loop_m=CITY_LOOP_M, **options)
        self._every = every
        self.name = self._drive.name
        self.timestamp_s = self._drive.timestamp_s[::every]
        self.poses = self._drive.poses[::every]

    def __len__(self) -> int:
        return len(self.poses)

    def scan(self, index: int) -> Scan:
        return self._drive.scan(index * self._every)


def _tracked(mapped: Drive, query: Drive) -> Evaluation:
    protocol = EvaluationProtocol(
        MapParameters.for_sensor(encoding="harmonic"), segments=5, track=True
    )
    return evaluate(mapped, protocol, query)


if __name__ == "__main__":
    folder, *rest = sys.argv[1:]
    sys.exit(1 if main(Path(folder), *rest) else 0)
