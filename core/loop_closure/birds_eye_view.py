"""Bird's-eye views of the structure around a sensor, and their alignment.

Two views are compared only in the cells that both scans could see: in each sector of azimuth, those
up to its farthest return. What a truck or a wall hides from one scan is no evidence.
"""

from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from core.arrays import Complex64Array, Float32Array, FloatArray, IntArray
from core.loop_closure.chance import above_chance
from core.projection.angles import azimuth_columns
from core.projection.visibility import SECTORS
from core.scans.scan import Scan

CELL_M = 0.5
"""Side of a cell: about the difference of a wall's place between two scans."""
_REACH_M = 40.0  # walls of a street; farther away a spinning sensor's returns are sparse
_CELLS = round(2 * _REACH_M / CELL_M)
_PADDED = 180  # cells of the transforms: a shift by up to 20 cells does not wrap around
_MOST_CELLS = 10  # of a shift, along each axis: 5 m, the most between two scans of one place
_SHIFTS = np.arange(-_MOST_CELLS, _MOST_CELLS + 1)
_SECTOR_DEG = 360 // SECTORS
_BEYOND_M = 1.0  # the farthest return of a sector is in a cell that is seen
_LEAST_COMMON = 0.3  # of a view: what fewer cells agree on may be by chance
_LOWEST_M, _HIGHEST_M = 0.5, 8.0  # above ground: without the road and the crowns of trees
_APART_M = 0.2  # returns that are nearer to each other count once
_AROUND_DEG = (-2.0, -1.0, 1.0, 2.0)  # of a heading: columns of an image are a degree wide
_BLUR_CELLS = 0.8  # a wall on the border of two cells may be in either


@dataclass(frozen=True)
class ViewAlignment:
    """The pose of a second view relative to a first one.

    Attributes:
        overlap: 0..1 in the best alignment: the cosine of the two views, where both scans see,
            above the median over all shifts, as a share of the most that is possible. So the
            overlap by chance, which is greater in dense surroundings, is subtracted.
        relative_yaw_deg: Relative yaw of the second sensor, counter-clockwise.
        forward_m: Its distance ahead of the first.
        lateral_m: Its distance to the left of the first.
    """

    overlap: float
    relative_yaw_deg: float
    forward_m: float
    lateral_m: float


def structure_m(scan: Scan, sensor_height_m: float) -> FloatArray:
    """Return the places of structure, `(n, 2)` metres around the sensor, each place once.

    Args:
        scan: The returns.
        sensor_height_m: The sensor's height above ground.
    """
    points = scan.points_m.astype(np.float64)
    height_m = points[:, 2] + sensor_height_m
    kept = (height_m > _LOWEST_M) & (height_m < _HIGHEST_M)
    kept &= (np.abs(points[:, :2]) < np.sqrt(2.0) * _REACH_M).all(axis=1)
    places = np.rint(points[kept, :2] / _APART_M).astype(np.int64)
    span = 2 * round(2.0 * _REACH_M / _APART_M)  # two coordinates in one number
    keys = np.unique(places[:, 0] * span + places[:, 1] + span // 2)
    return np.column_stack([keys // span, keys % span - span // 2]) * _APART_M


def birds_eye_view(places_m: FloatArray, relative_yaw_deg: float = 0.0) -> Float32Array:
    """Return which cells around the sensor are occupied, `(160, 160)`, blurred.

    Args:
        places_m: `(n, 2)` metres, from `structure_m`.
        relative_yaw_deg: How far they are rotated, counter-clockwise.
    """
    x, y = places_m.T
    cos, sin = np.cos(np.radians(relative_yaw_deg)), np.sin(np.radians(relative_yaw_deg))
    turned = np.stack([cos * x - sin * y, sin * x + cos * y])
    row, column = np.floor((turned + _REACH_M) / CELL_M).astype(np.int64)
    inside = (row >= 0) & (row < _CELLS) & (column >= 0) & (column < _CELLS)
    view = np.zeros((_CELLS, _CELLS), np.float32)
    view[row[inside], column[inside]] = 1.0
    from scipy.ndimage import gaussian_filter  # no answer needs it: decision 33

    blurred: Float32Array = gaussian_filter(view, _BLUR_CELLS, mode="constant")
    return blurred


def farthest_m(scan: Scan) -> FloatArray:
    """Return the horizontal distance of the farthest return in each sector of azimuth, `(60,)`.

    Sector 0 begins half a degree to the right of the front, as in images; 0 where no return is.
    """
    x, y = scan.points_m[:, :2].T.astype(np.float64)
    sector = azimuth_columns(scan.points_m, 360) // _SECTOR_DEG
    found = np.zeros(SECTORS)
    np.maximum.at(found, sector, x * x + y * y)
    return np.sqrt(found)


def seen_cells(reach_m: FloatArray, relative_yaw_deg: float = 0.0) -> Float32Array:
    """Return which cells around the sensor a scan could see, `(160, 160)`, 0 or 1.

    Args:
        reach_m: `(60,)`, from `farthest_m`.
        relative_yaw_deg: How far the scan is rotated, counter-clockwise.
    """
    of_degree_m = np.roll(np.repeat(reach_m + _BEYOND_M, _SECTOR_DEG), round(relative_yaw_deg))
    seen: Float32Array = (of_degree_m[_CELL_DEG] >= _CELL_FROM_M).astype(np.float32)
    return seen


def _cells_polar() -> tuple[IntArray, FloatArray]:
    """Return the azimuth, whole degrees from 0 to 359, and the distance of each cell's middle."""
    middle_m = (np.arange(_CELLS) + 0.5) * CELL_M - _REACH_M
    x, y = np.meshgrid(middle_m, middle_m, indexing="ij")
    return np.rint(np.degrees(np.arctan2(y, x))).astype(np.int64) % 360, np.hypot(x, y)


_CELL_DEG, _CELL_FROM_M = _cells_polar()


def _to_shifts() -> tuple[Complex64Array, Complex64Array]:
    """Return the inverse transform to the shifts alone, for its rows and its columns.

    It takes a third of the time of one to all shifts.
    """
    turns = 2j * np.pi / _PADDED
    rows = np.exp(turns * np.outer(_SHIFTS, np.arange(_PADDED)))
    columns = np.exp(turns * np.outer(np.arange(_PADDED // 2 + 1), _SHIFTS))
    columns[1:-1] *= 2.0  # the other half of a real signal's spectrum
    return rows.astype(np.complex64), (columns / _PADDED**2).astype(np.complex64)


_ROWS, _COLUMNS = _to_shifts()


def _spectra(view: Float32Array, seen: Float32Array) -> Complex64Array:
    """Return the transforms of a view, its squares and the seen cells, `(3, 180, 91)`."""
    from scipy.fft import rfft2  # of float32, seven times faster than NumPy's

    stacked = np.stack([view, view * view, seen])
    return np.asarray(rfft2(stacked, (_PADDED, _PADDED)))


def align_views(
    first: Scan, second: Scan, relative_yaws_deg: FloatArray, sensor_height_m: float
) -> ViewAlignment:
    """Return the best alignment of two scans near some headings, over all shifts within 5 m.

    Args:
        first: The scan that the answer is relative to.
        second: The other one.
        relative_yaws_deg: `(n,)` headings of the second relative to the first, whole degrees;
            around the best of them, others up to 2 degrees away are tried too.
        sensor_height_m: Height of both sensors above ground.
    """
    seen = seen_cells(farthest_m(first))
    fixed = birds_eye_view(structure_m(first, sensor_height_m)) * seen
    fixed_spectra = _spectra(fixed, seen)
    places_m, reach_m = structure_m(second, sensor_height_m), farthest_m(second)

    def aligned(relative_yaw_deg: float) -> ViewAlignment:
        seen = seen_cells(reach_m, relative_yaw_deg)
        view = birds_eye_view(places_m, relative_yaw_deg) * seen
        if not (fixed.any() and view.any()):
            return ViewAlignment(0.0, relative_yaw_deg, 0.0, 0.0)
        # What both have in common, and each one's squares where the other sees.
        spectra = np.conj(_spectra(view, seen)[[0, 2, 1]])
        product, of_fixed, of_view = (_ROWS @ (fixed_spectra * spectra) @ _COLUMNS).real
        least_fixed, least_view = (_LEAST_COMMON * np.vdot(of, of) for of in (fixed, view))
        near = product / np.sqrt(
            np.maximum(of_fixed, least_fixed) * np.maximum(of_view, least_view)
        )
        row, column = np.unravel_index(near.argmax(), near.shape)
        return ViewAlignment(
            min(1.0, max(0.0, above_chance(near))),
            relative_yaw_deg,
            float(_SHIFTS[row]) * CELL_M,
            float(_SHIFTS[column]) * CELL_M,
        )

    best = max(map(aligned, relative_yaws_deg.tolist()), key=attrgetter("overlap"))
    around = [aligned(best.relative_yaw_deg + off_deg) for off_deg in _AROUND_DEG]
    return max(best, *around, key=attrgetter("overlap"))
