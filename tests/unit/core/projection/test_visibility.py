"""Which way a scan sees."""

import numpy as np
import pytest

from core.errors import InvalidSignature
from core.evaluation.disturbances import KITTI_RECORDING, parse_disturbance
from core.projection.angles import azimuth_columns
from core.projection.imager import Imager, Views
from core.projection.reducer import Reducer
from core.projection.rings import RingGrid
from core.projection.visibility import SECTORS, View, seen_of_bits, visible_sectors
from core.scans.scan import Scan
from core.simulation import SimulatedDrive

IMAGER = Imager(RingGrid(), Reducer.HIGHEST, 1.73, (-1.5, 0.0, 1.5), Views.ANY)


@pytest.fixture(scope="module")
def street():
    return SimulatedDrive(seed=71, scans=40).scan(25)


def disturbed(scan, text):
    points_m = scan.points_m.astype(np.float64)
    rng = np.random.default_rng(3)
    return Scan.from_returns(parse_disturbance(text).apply(points_m, KITTI_RECORDING, rng))


def visible(scan):
    return visible_of(scan.points_m)


def visible_of(points_m):
    return visible_sectors(points_m, azimuth_columns(points_m, 360), 360)


@pytest.mark.parametrize(("text", "hidden_deg"), [("hidden:60", 60), ("hidden:120", 120)])
def test_a_sector_without_returns_is_hidden_and_no_other(street, text, hidden_deg):
    before, after = visible(street), visible(disturbed(street, text))
    assert not (after & ~before).any()
    assert abs((before & ~after).sum() - hidden_deg / 6) <= 1


def test_a_narrow_field_of_view_sees_what_is_in_it(street):
    # The image begins with azimuth 0, the front is half in the first sectors, half in the last.
    seen = np.flatnonzero(visible(disturbed(street, "fov:120")))
    assert set(seen.tolist()) <= {*range(11), *range(49, SECTORS)}
    assert len(seen) > 15


def test_a_truck_beside_the_vehicle_hides_sectors_and_the_road_ahead_stays_visible(street):
    before, after = visible(street), visible(disturbed(street, "truck:2"))
    assert (before & ~after).sum() >= 15
    assert after[[0, SECTORS - 1, 29, 30]].all()


def test_in_a_tunnel_everything_is_visible():
    azimuth, height_m = np.radians(np.arange(0.0, 360.0, 0.5)), np.linspace(-1.5, 2.0, 20)
    wall_m = np.stack([3.0 * np.cos(azimuth), 3.0 * np.sin(azimuth)], axis=1)
    points_m = np.concatenate([np.column_stack([wall_m, np.full(720, z)]) for z in height_m])
    assert visible_of(points_m.astype(np.float32)).all()


def test_of_few_returns_each_makes_its_sector_visible():
    points_m = np.array([[10.0, 1.0, 0.0], [0.0, 20.0, 0.0], [2.0, -2.0, 0.0]], np.float32)
    assert np.flatnonzero(visible_of(points_m)).tolist() == [1, 15, 52]


def test_hidden_columns_of_an_image_and_of_renderings_are_marked(street):
    scan = disturbed(street, "hidden:120")
    image = IMAGER.image(scan)
    assert set(np.unique(image.cells[:, image.cells[0] < 0])) == {-1.0}
    assert 18 <= len(image.view.hidden) <= 25
    assert (image.seen[:, image.cells[0] < 0] == 0.0).all()
    assert image.occupied_cells == np.count_nonzero(image.cells > 0)
    np.testing.assert_array_equal(IMAGER.render(scan)[1], image.cells)


def test_a_map_of_full_views_has_images_without_marks(street):
    full = Imager(IMAGER.grid, IMAGER.reducer, 1.73, IMAGER.lateral_renderings_m)
    assert full.image(disturbed(street, "hidden:120")).view.hidden == ()
    assert "views" not in full.as_attributes()
    assert IMAGER.as_attributes()["views"] == "any"


def test_bits_of_sectors_name_their_columns():
    assert np.flatnonzero(~seen_of_bits(np.array(0b101), 120)).tolist() == [0, 1, 4, 5]


@pytest.mark.parametrize(
    ("hidden", "said"),
    [
        ((3, 60), "sector 60 is hidden, wanted 0..59"),
        ((-1, 3), "sector -1 is hidden, wanted 0..59"),
        (tuple(range(60)), "60 sectors are hidden, wanted fewer than 60"),
    ],
)
def test_sectors_that_cannot_be_hidden_are_named(hidden, said):
    with pytest.raises(InvalidSignature, match=said):
        View(hidden)
