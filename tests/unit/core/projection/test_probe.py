"""Disturbed scans, always the same."""

import numpy as np
import pytest

from core.errors import InvalidParameters
from core.projection.imager import Imager
from core.projection.images import ConcatenatedImages, MemoryImages, Probes, project_drive
from core.projection.probe import (
    displacement_of_probe,
    probe_image,
    probe_scan,
)
from core.projection.reducer import Reducer
from core.projection.rings import RingGrid
from core.scans.displacement import seen_from_beside
from core.scans.scan import Scan
from tests.support.samples import SMALL_GRID, FaultyDrive, random_images, sample_drive

ALONE = Imager(SMALL_GRID, Reducer.LAST)
RENDERED = Imager(RingGrid(), Reducer.MEAN, 1.73, (-3.0, 0.0, 3.0))


NOWHERE = np.full((1, 7), np.nan)


def displacement_alone(position, imager):
    """Return the displacement of a probe of a scan whose pose is unknown."""
    return displacement_of_probe(position, imager, NOWHERE, 0)


def probe_alone(scan, position, imager):
    return probe_scan(scan, position, imager, displacement_alone(position, imager))


def test_a_probe_is_the_same_however_often_it_is_made():
    scan = sample_drive(3).scan(2)
    one, two = probe_alone(scan, 7, RENDERED), probe_alone(scan, 7, RENDERED)
    assert (one.points_m == two.points_m).all()
    assert not np.array_equal(one.points_m, probe_alone(scan, 8, RENDERED).points_m)


def test_a_probe_is_at_its_displacement_but_for_noise():
    above_cars = np.array([[30.0, 2.0, 20.0], [-20.0, 15.0, 20.0]])
    for imager, most_m in ((RENDERED, 0.5), (ALONE, 0.05)):
        for position in range(20):
            _, left_m, turn_deg = displacement_alone(position, imager)
            seen = seen_from_beside(np.repeat(above_cars, 500, axis=0), left_m, turn_deg)
            probe = probe_alone(Scan(np.repeat(above_cars, 500, axis=0)), position, imager)
            off_m = probe.points_m - seen
            assert np.abs(off_m.reshape(2, 500, 3).mean(axis=1)).max() < 0.2 * most_m
            assert off_m.std() < 1.05 * most_m


def test_probes_of_renderings_have_any_heading_and_those_of_the_papers_map_are_as_driven():
    rendered = np.array([displacement_alone(i, RENDERED) for i in range(400)])
    alone = np.array([displacement_alone(i, ALONE) for i in range(400)])
    assert -3.5 <= rendered[:, 1].min() < -3.0
    assert 3.0 < rendered[:, 1].max() <= 3.5
    assert rendered[:, 2].min() < -170.0
    assert rendered[:, 2].max() > 170.0
    assert np.abs(alone[:, 1]).max() <= 0.5
    assert np.std(alone[:, 2]) == pytest.approx(2.0, rel=0.2)


def test_a_probe_is_moved_towards_the_next_searched_scan_and_never_far():
    poses = np.zeros((5, 7))
    poses[:, 5] = poses[:, 6] = np.sqrt(0.5)  # all look along y
    poses[:, 1] = [0.0, 0.5, 2.0, 4.0, 90.0]

    def ahead_m(row):
        displaced = np.array([displacement_of_probe(i, ALONE, poses, row) for i in range(200)])
        beside = np.array([displacement_alone(i, ALONE) for i in range(200)])
        np.testing.assert_allclose(displaced[:, 1:], beside[:, 1:], atol=1e-9)
        return displaced[:, 0]

    first = ahead_m(0)
    assert 0.5 <= first.min() < 0.6  # the second scan is left out with it
    assert 1.9 < first.max() <= 2.0
    between = ahead_m(2)
    assert ((between <= -0.375) | (between >= 0.5)).all()
    assert (between.min(), between.max()) == pytest.approx((-1.5, 2.0), abs=0.1)
    assert ahead_m(4).min() >= -6.0
    assert np.ptp(ahead_m(4)) > 3.0
    unknown = displacement_of_probe(3, ALONE, np.vstack([poses[:1], NOWHERE]), 1)
    assert unknown == displacement_alone(3, ALONE)


def test_a_car_hides_what_is_behind_it_and_nothing_else():
    azimuth = np.radians(np.arange(0.0, 360.0, 0.5))
    low = np.column_stack([15 * np.cos(azimuth), 15 * np.sin(azimuth), np.full(720, -1.6)])
    shortened = 0
    for position in range(30):
        _, left_m, turn_deg = displacement_alone(position, RENDERED)
        seen = seen_from_beside(low, left_m, turn_deg)
        probe = probe_alone(Scan(low.astype(np.float32)), position, RENDERED).points_m
        moved = np.hypot(*seen.T[:2]) - np.hypot(*probe.T[:2]) > 3.0
        shortened += moved.any()
        # What is hidden is now in front, in the same direction from where it was recorded.
        back = seen_from_beside(probe, 0.0, -turn_deg) + np.array([0.0, left_m, 0.0])
        assert (np.hypot(*back[moved, :2].T) < 14.0).all()
        rotation = np.arctan2(back[moved, 1], back[moved, 0]) - np.arctan2(*low[moved, 1::-1].T)
        assert (np.abs((rotation + np.pi) % (2 * np.pi) - np.pi) < 0.6).all()  # noise, near by
    assert 10 <= shortened < 30


def test_a_probe_without_returns_has_no_image():
    far = Scan(np.array([[79.99, 0.0, 1.0]]))
    assert any(
        probe_image(far, i, RENDERED, displacement_alone(i, RENDERED)) is None for i in range(20)
    )


def test_a_drive_is_probed_as_it_is_projected_and_unusable_scans_are_left_out():
    drive = FaultyDrive(sample_drive(12), {3, 4})
    projected = project_drive(drive, np.arange(0, 12), ALONE)
    assert projected.probed.tolist() == projected.scans.tolist() == [0, 1, 2, *range(5, 12)]
    displacement = displacement_of_probe(5, ALONE, drive.poses, 5)
    expected = probe_image(drive.scan(5), 5, ALONE, displacement)
    assert expected is not None
    assert (projected.probes.read(3, 4)[0] == expected.cells).all()
    of_drive = (projected.scans, projected.probed, projected.displacement, projected.probes)
    probes = Probes.of_drives([of_drive])
    assert probes.rows.tolist() == list(range(10))
    assert probes.displacement[3].tolist() == list(displacement)


def test_probes_of_several_drives_follow_each_other():
    images = MemoryImages(random_images(2, SMALL_GRID.shape), SMALL_GRID)
    scans, probed = np.array([0, 2, 5]), np.array([2, 5])
    probes = Probes.of_drives([(scans, probed, np.eye(3)[:2], images)] * 2)
    assert probes.rows.tolist() == [1, 2, 4, 5]
    assert (probes.displacement[:2] == probes.displacement[2:]).all()
    assert len(probes.images) == 4
    assert isinstance(probes.images, ConcatenatedImages)


@pytest.mark.parametrize(
    ("rows", "displacements"),
    [([0], np.zeros((2, 3))), ([1, 0], np.zeros((2, 3))), ([0, 1], np.full((2, 3), np.nan))],
)
def test_probes_that_do_not_fit_together_are_rejected(rows, displacements):
    images = MemoryImages(random_images(2, SMALL_GRID.shape), SMALL_GRID)
    with pytest.raises(InvalidParameters):
        Probes(np.array(rows), displacements, images)
