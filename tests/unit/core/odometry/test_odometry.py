"""Odometry of simulated streets, whose poses are known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.errors import EmptyDrive, InvalidScan
from core.odometry.odometry import compute_odometry
from core.odometry.posed_drive import PosedDrive
from core.scans.drive import MemoryDrive
from core.scans.path import path_length_m
from core.scans.pose import matrices_from_rows
from core.scans.rigid import inverse
from core.scans.scan import Scan
from tests.support.odometry import needs_odometry
from tests.support.recording import recording

pytestmark = needs_odometry

HEIGHT_M = 1.73


def drive_of(scans):
    """Return a drive without poses, and the true ones."""
    scans = list(scans)
    drive = MemoryDrive("street", [Scan(scan.points_m, scan.timestamp_s) for scan in scans])
    return drive, np.array([scan.pose.as_tuple() for scan in scans])


def matrices(rows):
    poses = matrices_from_rows(rows)
    return inverse(poses[0]) @ poses


@pytest.fixture(scope="module")
def street():
    drive, true = drive_of(recording().scans)
    return drive, true, compute_odometry(drive, HEIGHT_M)


def test_the_poses_of_a_street_are_within_two_percent_of_its_length(street):
    _, true, found = street
    off = inverse(matrices(true)) @ matrices(found.poses)
    length_m = path_length_m(true)
    assert length_m > 45.0
    assert np.linalg.norm(off[:, :3, 3], axis=1).max() < 0.02 * length_m
    assert (found.lost, found.facts["closures"]) == ((), 0)
    assert found.facts["path_m"] == pytest.approx(length_m, rel=0.02)
    assert found.facts["registration"].startswith("kiss-icp 1.")


def test_the_farther_from_the_first_scan_the_less_a_pose_is_trusted(street):
    _, true, found = street
    assert found.sigmas[0].tolist() == [0.0, 0.0]
    assert (np.diff(found.sigmas, axis=0) >= 0.0).all()
    off_m = np.linalg.norm((matrices(true) - matrices(found.poses))[:, :2, 3], axis=1)
    assert (off_m[1:] < 3.0 * found.sigmas[1:, 0]).all()
    assert found.sigmas[-1, 0] < 0.03 * path_length_m(true)


def test_poses_repeat_bit_for_bit_and_do_not_depend_on_given_ones(street):
    drive, true, _ = street
    few = MemoryDrive("few", [drive.scan(at) for at in range(12)])
    once, again = (compute_odometry(of, HEIGHT_M) for of in (few, PosedDrive(few, true[:12])))
    assert once.poses.tobytes() == again.poses.tobytes()
    assert once.sigmas.tobytes() == again.sigmas.tobytes()
    assert once.facts == again.facts


def test_a_tilted_sensor_drives_on_level_ground(street):
    drive, true, _ = street
    tilt = Rotation.from_euler("y", 8.0, degrees=True)
    tilted = [Scan.from_returns(tilt.inv().apply(drive.scan(at).points_m)) for at in range(8)]
    found = compute_odometry(MemoryDrive("tilted", tilted), HEIGHT_M)
    assert np.abs(found.poses[:, 2]).max() < 0.1
    angles = Rotation.from_quat(found.poses[0, 3:]).as_euler("xyz", degrees=True)
    assert angles == pytest.approx([0.0, 8.0, 0.0], abs=0.5)
    assert found.poses[-1, 0] == pytest.approx(matrices(true)[7, 0, 3], rel=0.03)


def test_a_motion_that_starts_at_once_and_turns_on_the_spot_is_followed():
    scans = recording().scans
    turns_deg = [0.0, 0.0, 35.0, 70.0, 70.0, 35.0]
    turned = [
        Scan.from_returns(
            Rotation.from_euler("z", -turn, degrees=True).apply(scans[2 * at].points_m)
        )
        for at, turn in enumerate(turns_deg)
    ]
    found = compute_odometry(MemoryDrive("spin", turned), HEIGHT_M)
    steps_m = np.linalg.norm(np.diff(found.poses[:, :3], axis=0), axis=1)
    assert steps_m == pytest.approx(np.full(5, 3.0), abs=0.15)
    headings = Rotation.from_quat(found.poses[:, 3:]).as_euler("zyx", degrees=True)[:, 0]
    assert headings == pytest.approx(turns_deg, abs=1.0)


def test_scans_behind_a_gap_are_named_and_hardly_trusted():
    scans = recording().scans
    drive, _ = drive_of([*scans[:6], *scans[42:48]])
    found = compute_odometry(drive, HEIGHT_M)
    assert found.lost == (6,)
    assert (found.sigmas[6:, 0] > 5.0).all()
    assert found.sigmas[5, 0] < 1.0


class Numbered(MemoryDrive):
    """A drive without times whose scans are numbered."""

    def __init__(self, scans, numbers):
        super().__init__("numbered", [Scan(scan.points_m) for scan in scans])
        self.scan_index = np.array(numbers)


def behind_a_gap(first, lost, *, by_number=False):
    """Return odometry of six scans before a gap and two after it, and the motion across it."""
    scans = recording().scans
    numbers = [*range(first, first + 6), *range(first + 6 + lost, first + 8 + lost)]
    drive, true = drive_of([scans[number] for number in numbers])
    found = compute_odometry(Numbered(drive, numbers) if by_number else drive, HEIGHT_M)
    steps = (inverse(of[5]) @ of[6] for of in (matrices(found.poses), matrices(true)))
    return found, *steps


@pytest.mark.parametrize("lost", [3, 4, 6, 10, 16])
@pytest.mark.parametrize("first", [0, 10])
def test_poses_behind_a_gap_are_right_or_hardly_trusted(first, lost):
    found, step, true = behind_a_gap(first, lost)
    assert found.lost in ((), (6,))
    if found.lost:
        assert (found.sigmas[6:, 0] > 5.0).all()
    else:
        assert np.linalg.norm((inverse(step) @ true)[:3, 3]) < 0.3


@pytest.mark.parametrize("by_number", [False, True])
def test_across_a_short_gap_a_scan_is_found_where_the_velocity_leads(by_number):
    found, step, true = behind_a_gap(4, 6, by_number=by_number)
    assert found.lost == ()
    assert np.linalg.norm((inverse(step) @ true)[:3, 3]) < 0.3
    assert np.linalg.norm(true[:3, 3]) > 10.0
    assert found.sigmas[-1, 0] < 1.0


@pytest.mark.parametrize("lost", [5, 600])
def test_a_vehicle_that_stands_through_a_gap_is_not_lost(lost):
    points_m = recording().scans[0].points_m
    rng = np.random.default_rng(3)
    times_s = 0.1 * np.array([*range(8), *range(8 + lost, 12 + lost)])
    scans = [
        Scan((points_m + rng.normal(0.0, 0.02, points_m.shape)).astype(np.float32), time_s)
        for time_s in times_s.tolist()
    ]
    found = compute_odometry(MemoryDrive("parked", scans), HEIGHT_M)
    assert found.lost == ()
    assert np.abs(found.poses[:, :3]).max() < 0.1


class OfFiles(MemoryDrive):
    """A drive without times whose scans count from 0, but not the names of its files."""

    def __init__(self, scans, numbers):
        super().__init__("files", [Scan(scan.points_m) for scan in scans])
        self.named_index = None if numbers is None else np.array(numbers)


def step_over(drive, at):
    """Return odometry of a drive, and the motion from scan `at` to the next one by it."""
    found = compute_odometry(drive, HEIGHT_M)
    poses = matrices(found.poses)
    return found, inverse(poses[at]) @ poses[at + 1]


@pytest.mark.parametrize("every", [1, 10])
def test_numbers_that_are_names_of_files_show_a_gap(every):
    scans = recording().scans
    numbers = [*range(4, 10), 16, 17]
    drive, true = drive_of([scans[number] for number in numbers])
    found, step = step_over(OfFiles(drive, every * np.array(numbers)), 5)
    wanted = inverse(matrices(true)[5]) @ matrices(true)[6]
    assert found.lost == ()
    assert np.linalg.norm((inverse(step) @ wanted)[:3, 3]) < 0.3


def test_files_without_numbers_count_from_0():
    drive, _ = drive_of(recording().scans[:4])
    unnamed, plain = (compute_odometry(of, HEIGHT_M) for of in (OfFiles(drive, None), drive))
    assert unnamed.poses.tobytes() == plain.poses.tobytes()


def timed(scans):
    return [Scan(scan.points_m, 0.1 * at) for at, scan in enumerate(scans)]


def test_scans_that_a_frozen_sensor_repeats_are_missing_and_no_stop():
    scans = recording().scans
    _, true = drive_of([scans[9], scans[16]])
    frozen = timed([*scans[4:10], *[scans[9]] * 6, *scans[16:20]])
    found, step = step_over(MemoryDrive("frozen", frozen), 11)
    assert (found.lost, found.usable) == ((), True)
    assert np.linalg.norm((inverse(step) @ matrices(true)[1])[:3, 3]) < 0.3
    assert found.poses[5:12].tolist() == [found.poses[5].tolist()] * 7  # where they were taken


@pytest.mark.parametrize("times", [2, 7])
def test_a_recorder_that_stores_every_scan_several_times_changes_no_pose(times):
    scans = recording().scans[:10]
    once = compute_odometry(MemoryDrive("once", timed(scans)), HEIGHT_M)
    often = compute_odometry(
        MemoryDrive("often", timed([scan for scan in scans for _ in range(times)])), HEIGHT_M
    )
    assert often.lost == ()
    assert often.poses == pytest.approx(np.repeat(once.poses, times, axis=0), abs=0.01)


def test_a_drive_whose_first_scan_is_before_a_gap_is_followed_from_there():
    drive, true = drive_of(recording().scans[:8])
    times_s = [0.0, *(1.0 + 0.1 * at for at in range(7))]
    scans = [Scan(drive.scan(at).points_m, time_s) for at, time_s in enumerate(times_s)]
    found = compute_odometry(MemoryDrive("late", scans), HEIGHT_M)
    assert found.lost == ()
    off = inverse(matrices(found.poses)) @ matrices(true)
    assert np.linalg.norm(off[:, :3, 3], axis=1).max() < 0.5


def test_a_clock_that_stops_now_and_then_but_not_for_long_changes_no_pose():
    scans = recording().scans[:16]
    times_s = np.cumsum(np.where(np.arange(16) % 5 == 4, 0.25, 0.1)).tolist()
    even, uneven = (
        compute_odometry(
            MemoryDrive("clock", [Scan(s.points_m, t) for s, t in zip(scans, times, strict=True)]),
            HEIGHT_M,
        )
        for times in (np.arange(16.0).tolist(), times_s)
    )
    assert even.poses.tobytes() == uneven.poses.tobytes()


@pytest.mark.parametrize(("at", "lost"), [(0, (1,)), (5, (5, 6))])
def test_a_scan_without_a_return_in_range_is_lost_and_those_after_it_are_found(at, lost):
    scans = list(recording().scans[:10])
    far = Scan.from_returns(np.tile([150.0, 0.0, 0.0], (200, 1)))
    drive, true = drive_of(scans)
    given = [drive.scan(row) for row in range(10)]
    found = compute_odometry(MemoryDrive("far", [*given[:at], far, *given[at:]]), HEIGHT_M)
    assert found.lost == lost
    assert found.usable
    after = matrices(found.poses)[at + 1 :]
    off = inverse(inverse(after[0]) @ after) @ matrices(true[at:])
    assert np.linalg.norm(off[:, :3, 3], axis=1).max() < 0.5


def test_through_scans_without_a_return_in_range_the_velocity_is_kept():
    scans = list(recording().scans[:12])
    drive, true = drive_of(scans)
    far = Scan.from_returns(np.tile([150.0, 0.0, 0.0], (200, 1)))
    given = [far if at in (5, 6) else drive.scan(at) for at in range(12)]
    found = compute_odometry(MemoryDrive("dark", given), HEIGHT_M)
    assert found.lost == (5, 6, 7)
    off = inverse(matrices(found.poses)) @ matrices(true)
    assert np.linalg.norm(off[:, :3, 3], axis=1).max() < 0.5


class Unreadable(MemoryDrive):
    def scan(self, index):
        if index >= 2:
            raise InvalidScan("its file is broken")
        return super().scan(index)


def test_poses_are_not_usable_if_most_scans_are_not():
    drive, _ = drive_of(recording().scans[:5])
    found = compute_odometry(Unreadable("broken", [drive.scan(at) for at in range(5)]), HEIGHT_M)
    assert (found.fitting, found.lost, found.usable) == (2, (), False)


@pytest.mark.parametrize("returns", [1, 19])
def test_scans_of_too_few_returns_give_no_usable_poses(returns):
    points_m = np.column_stack([np.arange(returns) * 3.0 + 9.0, np.ones((returns, 2))])
    found = compute_odometry(MemoryDrive("few", [Scan(points_m.astype(np.float32))] * 2), 1.73)
    assert not found.usable
    assert found.lost == (1,)  # the first one counts


def test_a_scan_of_too_few_returns_is_lost_and_those_around_it_are_not():
    drive, _ = drive_of(list(recording().scans[:8]))
    given = [drive.scan(at) for at in range(8)]
    given[3] = Scan(given[3].points_m[:5])
    found = compute_odometry(MemoryDrive("gap", given), HEIGHT_M)
    assert found.usable
    assert 3 in found.lost
    assert {1, 2, 5, 6, 7}.isdisjoint(found.lost)


def test_a_drive_without_a_scan_has_no_odometry():
    with pytest.raises(EmptyDrive, match="drive nothing has no scan"):
        compute_odometry(MemoryDrive("nothing", []), HEIGHT_M)


def test_poses_of_many_scans_stay_rigid():
    around = np.random.default_rng(1).uniform([-30, -30, -2], [30, 30, 4], (150, 3))
    headings = [Rotation.from_euler("z", 3.0 * at, degrees=True) for at in range(400)]
    scans = [Scan.from_returns(heading.inv().apply(around)) for heading in headings]
    found = compute_odometry(MemoryDrive("round", scans), HEIGHT_M)
    true = Rotation.concatenate(headings).as_matrix()
    off = inverse(matrices(found.poses))[:, :3, :3] @ true
    assert np.abs(off - np.eye(3)).max() < 0.01
