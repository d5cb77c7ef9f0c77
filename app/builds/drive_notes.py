"""Notes of a build on its drives: scans that it left out, poses and times that are not right."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from typing import Protocol

import numpy as np

from core.arrays import FloatArray, IntArray
from core.mapping.pipeline import Build
from core.mapping.tensormap import TensorMap
from core.scans.pose_steps import jumps, usual_step
from core.scans.times import decreasing_rows
from core.text import count_of, verb_of

_LEAST_IN_A_ROW, _LEAST_EQUAL = 5, 3  # a drive that stores a scan twice now and then is not frozen
_LEAST_SHARE, _NEARLY_ALL = 0.2, 0.9  # of the scans that have one before them
_LONG_S, _MOVED_M, _SLOW_MPS = 10.0, 0.2, 0.2  # scans of a drive are rarely as far apart as slow


class NotedDrive(Protocol):
    """A drive as it was recorded, stored or not, of which the digests of its scans are known."""

    @property
    def name(self) -> str:
        """A short name."""

    @property
    def scan_index(self) -> IntArray:
        """`(K,)` the number of each scan."""

    @property
    def digests(self) -> Sequence[str]:
        """`K` digests of the scans' returns."""


def drive_notes(tensor_map: TensorMap, drives: Sequence[NotedDrive]) -> Iterator[str]:
    """Yield notes on drives of a map whose scans, poses or times are not right.

    Equal scans in a row or in two drives, missing poses, times that decrease or seem to be no
    seconds, and poses too far apart. Of computed poses odometry notes what is not right itself.
    """
    yield from equal_scan_notes(drives)
    trajectory = tensor_map.trajectory
    for drive in drives:
        rows = trajectory.rows_of(drive.name)
        index = trajectory.scan_index[rows]
        without = int((~trajectory.known[rows]).sum())
        if 0 < without < len(index):
            have = verb_of(without, "has", "have")
            yield f"{without} of {len(index)} scans of drive {drive.name} {have} no pose"
        timestamp_s = trajectory.timestamp_s[rows]
        yield from time_notes(drive.name, index, timestamp_s)
        if drive.name not in tensor_map.computed_poses:
            yield from motion_notes(drive.name, index, timestamp_s, trajectory.poses[rows])


def equal_scan_notes(drives: Sequence[NotedDrive]) -> Iterator[str]:
    """Yield notes on drives that have the scans of an earlier one, or the same scan in a row."""
    yield from _twice_notes(drives)
    for drive in drives:
        yield from _frozen_notes(drive)


def time_notes(name: str, scan_index: IntArray, timestamp_s: FloatArray) -> Iterator[str]:
    """Yield a note if times of a drive decrease.

    Args:
        name: The drive's name.
        scan_index: `(n,)` the number of each scan.
        timestamp_s: `(n,)` seconds, NaN where unknown.
    """
    earlier = decreasing_rows(timestamp_s)
    if len(earlier):
        yield (
            f"the times of drive {name} decrease at {len(earlier)} of {len(scan_index)} scans,"
            f" first at scan {scan_index[earlier[0]]}: are its scans in the order in which they"
            " were taken?"
        )


def motion_notes(
    name: str, scan_index: IntArray, timestamp_s: FloatArray, poses: FloatArray
) -> Iterator[str]:
    """Yield notes on given poses that are too far apart, and times that seem no seconds.

    Of times in milliseconds the vehicle would seem to stand at every scan. Arguments as of `jumps`.
    """
    step_s, step_m = usual_step(timestamp_s, poses)
    if step_s >= _LONG_S and step_m >= _MOVED_M and step_m < _SLOW_MPS * step_s:
        yield (
            f"the scans of drive {name} are {step_s:g} s and {step_m:.2g} m apart, as of a vehicle"
            f" at {step_m / step_s:.2g} m/s: are its times in seconds?"
        )
    found = jumps(scan_index, timestamp_s, poses)
    if len(found):
        yield (
            f"the poses of drive {name} jump farther than a vehicle moves at {len(found)} of"
            f" {len(scan_index)} scans, first at scan {found[0]}: are they another drive's?"
        )


def left_out_notes(built: Build, accumulate: Mapping[str, int]) -> Iterator[str]:
    """Yield a note on each drive some of whose scans were left out of the map.

    Args:
        built: The map and what was left out.
        accumulate: How many scans of each of its drives become one.
    """
    trajectory = built.tensor_map.trajectory
    for name, of_one in accumulate.items():
        left_out = built.skipped.get(name)
        if left_out:
            kept = len(trajectory.scan_index[trajectory.rows_of(name)])
            made_of = f", each of {of_one} that become one," * (of_one != 1)
            yield (
                f"{len(left_out)} of {count_of(kept + len(left_out), 'scan')} of drive {name}"
                f"{made_of} {verb_of(len(left_out), 'is', 'are')} left out, first scan"
                f" {left_out[0].scan}: {left_out[0].reason}"
            )


def _twice_notes(drives: Sequence[NotedDrive]) -> Iterator[str]:
    """Yield a note on each drive that has the scans of an earlier one, the first of these."""
    holders: dict[str, tuple[int, ...]] = {}
    for at, drive in enumerate(drives):
        digests = set(drive.digests)
        shared = Counter(chain.from_iterable(holders.get(digest, ()) for digest in digests))
        least = max(_LEAST_EQUAL, _LEAST_SHARE * len(digests))
        first = min((earlier for earlier in shared if shared[earlier] >= least), default=None)
        if first is not None:
            yield (
                f"{shared[first]} of {len(digests)} scans of drive {drive.name} are those of drive"
                f" {drives[first].name}: is one recording there twice? Leave one out"
            )
        if len(digests) not in shared.values():  # else an earlier one has all that it has
            for digest in digests:
                holders[digest] = (*holders.get(digest, ()), at)


def _frozen_notes(drive: NotedDrive) -> Iterator[str]:
    """Yield a note on scans whose returns are those of the scan before: noise makes others."""
    digests = np.array(drive.digests)
    starts = np.flatnonzero(np.r_[True, digests[1:] != digests[:-1]])
    in_a_row = np.diff(np.r_[starts, len(digests)])
    equal = len(digests) - len(starts)
    most = int(np.argmax(in_a_row))
    if in_a_row[most] < _LEAST_IN_A_ROW and equal < max(
        _LEAST_EQUAL, _LEAST_SHARE * (len(digests) - 1)
    ):
        return
    first, last = drive.scan_index[[starts[most], starts[most] + in_a_row[most] - 1]].tolist()
    one_place = equal >= _NEARLY_ALL * (len(digests) - 1)
    yield (
        f"{equal} of {len(digests)} scans of drive {drive.name} are equal to the scan before them,"
        f" most in a row are scans {first} to {last}: did the sensor or its driver stop, and send"
        f" its last scan again?{' they show one place' if one_place else ''}"
    )
