"""The scans of two maps, and self-recall."""

import numpy as np

from core.evaluation.self_recall import finds_own, is_findable
from core.mapping.diff import DriveOverlap, drive_overlaps
from core.mapping.own_place import own_place
from core.projection.images import MemoryImages
from tests.support.samples import SMALL_GRID, calibrated_map, sample_map, smooth_images


def test_overlaps_count_every_scan_of_either_map_once():
    this, other = sample_map()[0], sample_map()[0]
    (overlap,) = drive_overlaps(this, other)
    assert overlap == DriveOverlap(this.trajectory.drives[0], len(this), 0, 0)
    anew = drive_overlaps(this, other, recorded_anew=frozenset(this.trajectory.drives))
    assert anew == (DriveOverlap(overlap.drive, 0, len(this), len(other)),)


def test_the_nearest_scans_are_left_out_and_the_near_ones_are_right():
    trajectory = calibrated_map().trajectory
    row = len(trajectory) // 2
    among, near = own_place(trajectory, row)
    apart = np.linalg.norm(trajectory.poses[:, :3] - trajectory.poses[row, :3], axis=1)
    np.testing.assert_array_equal(among, apart >= 1.0)
    np.testing.assert_array_equal(near, (apart >= 1.0) & (apart < 10.0))


def test_a_map_finds_the_neighbours_of_its_scans():
    tensor_map, images = calibrated_map(), smooth_images(120, SMALL_GRID.shape)
    source = MemoryImages(images, SMALL_GRID)
    rows = list(range(0, 120, 10))
    assert all(is_findable(tensor_map, row) for row in rows)
    assert finds_own(tensor_map, rows, [(source, row) for row in rows]).all()
    elsewhere = [(source, (row + 60) % 120) for row in rows]
    assert not finds_own(tensor_map, rows, elsewhere).any()


def test_a_scan_without_a_neighbour_cannot_be_found():
    alone = sample_map(6, 3, step_m=20.0)[0]
    assert not any(is_findable(alone, row) for row in range(6))
    source = MemoryImages(sample_map(6, 3)[1], SMALL_GRID)
    assert not finds_own(alone, [2], [(source, 2)]).any()
