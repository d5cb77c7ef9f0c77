"""What tracks report where the map does not reach; the last table of tracking-measurements.md.

    python -m benchmarks.tracks_elsewhere DRIVES

DRIVES is a folder of the recorded drives in the KITTI odometry layout. Of each every other scan is
mapped and the others are a second drive; simulated cities have seeds on which nothing was chosen.
Each map is driven in by all drives, and in each of them vehicles stand. A bar is missed by a place
that is wrong, by one of a vehicle that moves elsewhere, and by many of vehicles that stand there.
"""

import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.accuracy import commit, print_table
from benchmarks.timing import machine
from core.evaluation.condition import Condition
from core.evaluation.selected import SelectedScans
from core.localization.localizer import Localizer
from core.mapping.pipeline import build_map
from core.parameters import MapParameters
from core.scans.drive import Drive
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from core.tracking.track import Observation, Track, Tracker
from storage.formats.drives.layouts import open_drive

RECORDED = ("nclt_turn", "kitti00", "kit_muehlburger", "kitti_drive0001")
SEEDS = (401, 402)
CITY_SCANS, FIRINGS = 300, 180
CONDITIONS = (Condition(), Condition(disturb="hidden:120"), Condition(disturb="drop:0.9"))
MOST_OBSERVATIONS = 200  # of a drive
STANDING, OBSERVATIONS = 20, 25  # places of a drive where a vehicle stands, and how often it asks
_RIGHT_M = 10.0
STANDING_BAR = 0.05  # share of vehicles standing elsewhere that get a place


@dataclass(frozen=True)
class Place:
    """A map, and a second drive through it."""

    name: str
    mapped: Drive
    driven: Drive

    @cached_property
    def tracker(self) -> Tracker:
        """The tracker of its map."""
        parameters = MapParameters.for_sensor(encoding="harmonic")
        return Tracker(Localizer(build_map(self.mapped, parameters)))


@dataclass
class Count:
    """Vehicles or observations that were given a place, of how many."""

    placed: int = 0
    of: int = 0

    def add(self, placed: int, of: int) -> None:
        """Count more of them."""
        self.placed += placed
        self.of += of

    def __str__(self) -> str:
        return f"{self.placed} of {self.of}"


def main(folder: Path) -> int:
    """Print the table, and return how many bars were missed."""
    threadpool_limits(limits=1)
    print(f"At commit {commit()}, on {machine()}.\n", flush=True)
    places = [*_recorded(folder), *map(_city, SEEDS)]
    rows: list[list[str]] = []
    missed: list[str] = []
    for place in places:
        for condition in CONDITIONS:
            name = f"{place.name}, {condition.disturb or 'as recorded'}"
            observed = _observed(place.tracker, place.driven, condition)
            reported, wrong = _reported(place, observed)
            standing = _standing(place.tracker, observed[::9])
            others = [other.driven for other in places if other is not place]
            moving_elsewhere, standing_elsewhere = _elsewhere(place.tracker, others, condition)
            of_map = str(reported), str(wrong), str(standing)
            rows.append([name, *of_map, str(moving_elsewhere), str(standing_elsewhere)])
            print(" | ".join(rows[-1]), file=sys.stderr, flush=True)
            if wrong:
                missed.append(f"{name}: {wrong} wrong places")
            if moving_elsewhere.placed:
                missed.append(f"{name}: moving elsewhere {moving_elsewhere} have a place")
            if standing_elsewhere.placed > STANDING_BAR * standing_elsewhere.of:
                missed.append(f"{name}: standing elsewhere {standing_elsewhere} have a place")
    titles = "map, view", "reported", "wrong", "standing", "elsewhere, moving", "standing there"
    print_table(titles, rows)
    for bar in missed:
        print(f"missed: {bar}")
    return len(missed)


def _recorded(folder: Path) -> Iterable[Place]:
    for name in RECORDED:
        drive = open_drive(folder / name, min_returns=100)
        scans = np.arange(len(drive))
        yield Place(name, SelectedScans(drive, scans[::2]), SelectedScans(drive, scans[1::2]))


def _city(seed: int) -> Place:
    sensor = SimulatedSensor(firings=FIRINGS)
    mapped = SimulatedDrive(seed=seed, scans=CITY_SCANS, sensor=sensor)
    driven = SimulatedDrive(
        seed=seed, scans=CITY_SCANS, sensor=sensor, noise_seed=seed, lateral_offset_m=1.5
    )
    return Place(f"city {seed}", mapped, driven)


def _observed(tracker: Tracker, drive: Drive, condition: Condition) -> list[Observation]:
    basis, found = tracker.localizer.basis, []
    for row in range(min(len(drive), MOST_OBSERVATIONS)):
        scan = condition.apply(drive.scan(row), np.random.default_rng(row))
        found.append(Observation(basis.encode(basis.image(scan))))
    return found


def _reported(place: Place, observed: Sequence[Observation]) -> tuple[Count, int]:
    """Return how many observations were given a place, and how many of these a wrong one."""
    track, mapped_m = Track(place.tracker), place.tracker.map.trajectory.poses[:, :3]
    reported, wrong = Count(), 0
    for row, observation in enumerate(observed):
        step = track.observe(observation)
        reported.add(int(step.localized), 1)
        apart_m = np.linalg.norm(mapped_m[step.row] - place.driven.poses[row, :3])
        wrong += bool(step.localized and apart_m > _RIGHT_M)
    return reported, wrong


def _elsewhere(
    tracker: Tracker, drives: Iterable[Drive], condition: Condition
) -> tuple[Count, Count]:
    """Return how many observations of drives that are not mapped, and of stops there, had one."""
    moving, standing = Count(), Count()
    for drive in drives:
        observed = _observed(tracker, drive, condition)
        moving.add(_localized(tracker, observed), len(observed))
        stops = _standing(tracker, observed[:: max(1, len(observed) // STANDING)])
        standing.add(stops.placed, stops.of)
    return moving, standing


def _standing(tracker: Tracker, observed: Sequence[Observation]) -> Count:
    """Return how many vehicles that repeat their observation are given a place."""
    placed = [_localized(tracker, [observation] * OBSERVATIONS) > 0 for observation in observed]
    return Count(sum(placed), len(placed))


def _localized(tracker: Tracker, observed: Iterable[Observation]) -> int:
    track = Track(tracker)
    return sum(track.observe(observation).localized for observation in observed)


if __name__ == "__main__":
    sys.exit(1 if main(Path(sys.argv[1])) else 0)
