"""Images and renderings of scans, to the bit, against whole arrays and `arctan2`."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from core.arrays import FloatArray
from core.errors import InvalidScan
from core.projection.blocks import RETURNS_ONCE
from core.projection.imager import ImageKind, Imager, Views
from core.projection.levelling import level
from core.projection.reducer import HEIGHT_REDUCERS, MOST_M, RANGE_REDUCERS, Reducer
from core.projection.rings import RingGrid
from core.scans.scan import Scan
from core.scans.sensor import AngularGrid
from core.simulation import SimulatedDrive

HEIGHT_M = 1.73
LEFT_M = (-1.6, 0.0, 3.0)
RINGS = [RingGrid(), RingGrid(10.0, 3, 7.2), RingGrid(2.0, 40, 0.5), RingGrid(4.0, 20, 90.0)]
ANGLES = [AngularGrid(), AngularGrid(-30.0, 10.0, 6, 20.0, wraps=True)]
SIMULATED = SimulatedDrive(seed=5, scans=4).scan(2).points_m
RULES: dict[Reducer, Callable[[FloatArray], float]] = {
    Reducer.LAST: lambda values: values[-1],
    Reducer.NEAREST: np.min,
    Reducer.FARTHEST: np.max,
    Reducer.HIGHEST: np.max,
    Reducer.MEAN: lambda values: np.cumsum(values)[-1] / len(values),
}

imagers = st.one_of(
    st.builds(
        Imager,
        st.sampled_from(RINGS),
        st.sampled_from(HEIGHT_REDUCERS),
        st.just(HEIGHT_M),
        st.just(LEFT_M),
        st.sampled_from(Views),
    ),
    st.builds(
        Imager,
        st.sampled_from(ANGLES),
        st.sampled_from(RANGE_REDUCERS),
        st.just(HEIGHT_M),
        st.just(LEFT_M),
        st.sampled_from(Views),
    ),
)
# A return may become zero beside the line, be on the edge of a ring, or be beyond all of them.
coordinates = st.floats(-90.0, 90.0, width=32) | st.sampled_from(
    [0.0, -0.0, -1.6, 3.0, 4.0, 6.0, 1e-45, 1e9, 2e30, -3.4e38]
)
points = st.tuples(coordinates, coordinates, coordinates)
ABREAST = [(20.0 * np.cos(a), 20.0 * np.sin(a), 0.0) for a in np.radians(np.arange(36, 325, 7.2))]


def in_no_block(scan, imager):
    """Return the cells of a levelled scan as they are defined, `None` where it has no image."""
    x, y, z = scan.points_m.T.astype(np.float64)
    across_m = np.sqrt(x * x + y * y)
    azimuth_deg = np.degrees(np.arctan2(y, x))
    grid = imager.grid
    column = np.rint(azimuth_deg / grid.azimuth_step_deg).astype(np.int64)
    if imager.kind == ImageKind.HEIGHT:
        row, values = np.floor(across_m / grid.ring_m), np.maximum(z + HEIGHT_M, 0.0)
        column %= grid.columns
    else:
        with np.errstate(divide="ignore"):
            elevation_deg = np.degrees(np.arctan(z / across_m))
        row = np.rint(elevation_deg / grid.elevation_step_deg)
        row -= grid.elevation_min_deg / grid.elevation_step_deg
        values = np.sqrt(across_m * across_m + z * z)
        column += round(180.0 / grid.azimuth_step_deg)
        column = column % grid.columns if grid.wraps else column
    inside = (row >= 0) & (row < grid.rows)
    if not inside.any() or values[inside].max() > MOST_M:
        return None
    flat = row[inside].astype(np.int64) * grid.columns + column[inside]
    cells = reduced(flat, values[inside], imager.reducer, grid.shape)
    if imager.kind == ImageKind.HEIGHT and imager.views == Views.ANY:
        cells[:, ~seen_columns(across_m, column, grid.columns)] = -1.0
    return cells if (cells > 0).any() else None


def reduced(flat, values, reducer, shape):
    order = np.argsort(flat, kind="stable")
    occupied, first = np.unique(flat[order], return_index=True)
    cells = np.zeros(shape[0] * shape[1], np.float32)
    cells[occupied] = [RULES[reducer](some) for some in np.split(values[order], first[1:])]
    cells[cells < np.finfo(np.float32).tiny] = 0.0
    return cells.reshape(shape)


def seen_columns(across_m, column, columns):
    """Return which columns are in a visible sector (decision 30)."""
    sector = np.arange(columns) * 60 // columns
    far, near = (np.isin(np.arange(columns), some) for some in (column[across_m > 6.0], column))
    wide = np.array([(sector == s).sum() for s in range(60)])
    visible = np.array([2 * far[sector == s].sum() for s in range(60)]) >= np.maximum(wide, 1)
    if visible.sum() < 10:
        visible = np.array([near[sector == s].any() for s in range(60)])
    return visible[sector]


def beside(scan, left_m):
    """Return a scan seen from the left; float32 keeps its coordinates, zero is no return."""
    points_m = (scan.points_m.astype(np.float64) - [0.0, left_m, 0.0]).astype(np.float32)
    points_m = points_m[(points_m != 0.0).any(axis=1)]
    return Scan(points_m) if len(points_m) else None


def expect(wanted, image):
    """Check an image to the bit, or that there is none."""
    if wanted is None:
        with pytest.raises(InvalidScan):
            image()
    else:
        assert image().tobytes() == wanted.tobytes()


def check(scan, imager):
    levelled = level(scan, HEIGHT_M) if imager.views == Views.ANY else scan
    expect(in_no_block(levelled, imager), lambda: imager.image(scan).cells)
    seen = [beside(levelled, left_m) for left_m in LEFT_M]
    rendered = [None if one is None else in_no_block(one, imager) for one in seen]
    usable = [cells for cells in rendered if cells is not None and cells.max() <= 1e8]
    wanted = np.stack(usable) if len(usable) == len(LEFT_M) else None
    expect(wanted, lambda: imager.render(scan))


@given(st.lists(points, min_size=1, max_size=40), imagers)
@example([(6.0, 0.0, 1.0), *ABREAST], Imager(RINGS[1], Reducer.MEAN, HEIGHT_M, LEFT_M, Views.ANY))
@example([(0.0, 3.0, 0.0), (9.0, 1.0, 1.0)], Imager(RINGS[0], Reducer.HIGHEST, HEIGHT_M, LEFT_M))
def test_few_returns_have_the_image_of_whole_arrays(points, imager):
    points_m = np.array(points, np.float32)
    points_m = points_m[(points_m != 0.0).any(axis=1)]
    if len(points_m):
        check(Scan(points_m), imager)


@settings(max_examples=20)  # each is eight images of some 12,000 returns
@given(st.integers(0, 10_000), st.sampled_from([0.0, 0.08]), imagers)
def test_a_scan_of_some_blocks_has_the_image_of_whole_arrays(seed, slope, imager):
    rng = np.random.default_rng(seed)
    points_m = SIMULATED[rng.integers(len(SIMULATED), size=2 * RETURNS_ONCE + 5)].copy()
    points_m[:, 2] += np.float32(slope) * points_m[:, 0]
    hidden_deg = np.degrees(np.arctan2(points_m[:, 1], points_m[:, 0])) - rng.uniform(-180, 180)
    check(Scan(points_m[np.abs(hidden_deg) > 40.0]), imager)
