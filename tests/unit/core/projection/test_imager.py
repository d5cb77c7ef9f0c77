"""Images, their kinds and the renderings of a scan."""

import numpy as np
import pytest

from core.errors import InvalidImage, InvalidParameters, InvalidScan
from core.projection.imager import Image, ImageKind, Imager
from core.projection.reducer import HEIGHT_REDUCERS, RANGE_REDUCERS, Reducer
from core.projection.rings import RingGrid
from core.scans.scan import Scan
from core.scans.sensor import AngularGrid
from tests.support.samples import sample_points


@pytest.mark.parametrize(("grid", "kind"), [(AngularGrid(), "range"), (RingGrid(), "height")])
@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda cells: cells[:, :300], r"shape \(\d+, 300\), wanted \(\d+, 36\d\)"),
        (lambda cells: cells * 0, "empty"),
        (lambda cells: cells - 1.5, "negative"),
        (lambda cells: cells * np.nan, "not finite"),
        (lambda cells: cells.astype(np.float64) * 1e300, "not finite"),
        (lambda cells: cells * np.float32(3e38), r"above 1e\+30"),
    ],
)
def test_cells_that_are_no_image_are_rejected(grid, kind, change, reason):
    with pytest.raises(InvalidImage, match=f"the {kind} image .*{reason}"):
        Image(change(np.ones(grid.shape, np.float32)), grid)


def test_a_column_of_heights_is_hidden_as_a_whole_and_none_of_ranges_is():
    cells = np.ones((20, 360), np.float32)
    cells[:, 6:12] = -1.0
    assert Image(cells, RingGrid()).view.hidden == (1,)
    one = np.ones((20, 360), np.float32)
    one[:, 7] = -1.0  # as where a client leaves out its trailer's columns
    np.testing.assert_array_equal(Image(one, RingGrid()).cells, cells)
    with pytest.raises(InvalidImage, match="a hidden column in every sector"):
        Image(np.where(np.arange(360) % 6 == 0, np.float32(-1.0), one), RingGrid())
    cells[5, 7] = 0.0
    with pytest.raises(InvalidImage, match="hidden in some rows"):
        Image(cells, RingGrid())
    with pytest.raises(InvalidImage, match="a hidden column in every sector"):
        Image(np.full((20, 360), -1.0, np.float32), RingGrid())
    with pytest.raises(InvalidImage, match="negative"):
        Image(
            np.where(np.arange(361) == 7, np.float32(-1.0), np.ones((30, 361), np.float32)),
            AngularGrid(),
        )


def test_an_image_is_shown_in_a_line_without_its_cells():
    cells = np.zeros((20, 360), np.float32)
    cells[3, 4:9] = 2.0
    assert (
        repr(Image(cells, RingGrid())) == "Image(kind='height', shape=(20, 360), occupied_cells=5)"
    )


def test_an_image_is_read_only():
    image = Image(np.ones((30, 361), np.float32), AngularGrid())
    with pytest.raises(ValueError, match="read-only"):
        image.cells[0, 0] = 2.0


def test_each_kind_of_image_has_its_own_reducers():
    with pytest.raises(InvalidParameters, match=r"wanted last, .* for a range image"):
        Imager(AngularGrid(), Reducer.HIGHEST)
    for reducer in set(RANGE_REDUCERS) - set(HEIGHT_REDUCERS):
        with pytest.raises(InvalidParameters, match="wanted mean, highest for a height image"):
            Imager(RingGrid(), reducer)
    assert Imager(RingGrid(), Reducer.MEAN).kind == ImageKind.HEIGHT


def test_a_scan_is_rendered_from_each_place():
    scan = Scan(sample_points(1))
    imager = Imager(RingGrid(), Reducer.MEAN, 1.73, (-2.0, 0.0, 2.0))
    rendered = imager.render(scan)
    assert rendered.shape == imager.shape == (3, 20, 360)
    np.testing.assert_array_equal(rendered[1], imager.image(scan).cells)
    there = Scan.from_returns(scan.points_m - np.array([0.0, 2.0, 0.0], np.float32))
    np.testing.assert_allclose(rendered[2], imager.image(there).cells, atol=1e-5)


@pytest.mark.parametrize(
    ("imager", "beyond"),
    [
        (Imager(AngularGrid(), Reducer.LAST), [2e8, 0.0, 0.0]),
        (Imager(RingGrid(), Reducer.HIGHEST, 1.73, (-2.0, 0.0)), [9.0, 0.0, 2e8]),
    ],
)
def test_a_scan_of_a_map_has_no_return_that_no_sensor_measures(imager, beyond):
    points = sample_points(1)
    scan = Scan(np.concatenate([points, np.array([beyond], np.float32)]))
    with pytest.raises(InvalidScan, match=r"2e\+08 m .* at most 1e\+08"):
        imager.render(scan)
    imager.image(scan)
    imager.render(Scan(points))


def test_a_query_may_be_of_a_sensor_mounted_otherwise():
    scan = Scan(sample_points(1))
    lower = Scan(scan.points_m - np.array([0.0, 0.0, 0.5], np.float32))
    imager = Imager(RingGrid(), Reducer.HIGHEST, 1.73)
    np.testing.assert_allclose(imager.image(lower, 2.23).cells, imager.image(scan).cells, atol=1e-5)
    ranges = Imager(AngularGrid(), Reducer.MEAN, 1.73)
    np.testing.assert_array_equal(ranges.image(scan, 9.0).cells, ranges.image(scan).cells)


@pytest.mark.parametrize(
    "offsets", [(), (0.0, 0.0), (1.0, -1.0), (float("nan"),), (51.0,), tuple(range(-40, 41))]
)
def test_renderings_that_cannot_be_are_rejected(offsets):
    with pytest.raises(InvalidParameters, match="lateral_renderings_m"):
        Imager(RingGrid(), Reducer.MEAN, 1.73, offsets)


def test_there_is_one_zero():
    imager = Imager(RingGrid(), Reducer.MEAN, 1.73, (-0.0,))
    assert str(imager.lateral_renderings_m) == "(0.0,)"
