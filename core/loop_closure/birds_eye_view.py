"""Bird's-eye views of the structure around a sensor, and their alignment."""

from dataclasses import dataclass

import numpy as np
from scipy import fft
from scipy.ndimage import gaussian_filter

from core.arrays import Float32Array, FloatArray
from core.scans.scan import Scan

CELL_M = 0.5
"""Side of a cell: about the difference of a wall's place between two scans."""
_REACH_M = 40.0  # walls of a street; farther away a spinning sensor's returns are sparse
_CELLS = round(2 * _REACH_M / CELL_M)
_PADDED = 192  # cells of the transforms: a shift by up to 32 cells does not wrap around
_MOST_CELLS = 10  # of a shift, along each axis: 5 m, the most between two scans of one place
_LOWEST_M, _HIGHEST_M = 0.5, 8.0  # above ground: without the road and the crowns of trees
_APART_M = 0.2  # returns that are nearer to each other count once
_LEAST = 1e-6
_BLUR_CELLS = 0.8  # a wall on the border of two cells may be in either


@dataclass(frozen=True)
class Alignment:
    """The pose of a second view relative to a first one.

    Attributes:
        overlap: 0..1 in the best alignment: the cosine of the two views above the median over all
            shifts, as a share of the most that is possible. So the overlap by chance, which is
            greater in dense surroundings, is subtracted.
        turn_deg: Relative yaw of the second sensor, counter-clockwise.
        forward_m: Its distance ahead of the first.
        lateral_m: Its distance to the left of the first.
    """

    overlap: float
    turn_deg: float
    forward_m: float
    lateral_m: float


def structure_m(scan: Scan, sensor_height_m: float) -> FloatArray:
    """Return the places of structure, `(n, 2)` metres around the sensor, each place once.

    Args:
        scan: The returns.
        sensor_height_m: Of the sensor above ground.
    """
    points = scan.points_m.astype(np.float64)
    height_m = points[:, 2] + sensor_height_m
    kept = (height_m > _LOWEST_M) & (height_m < _HIGHEST_M)
    kept &= (np.abs(points[:, :2]) < np.sqrt(2.0) * _REACH_M).all(axis=1)
    places = np.rint(points[kept, :2] / _APART_M).astype(np.int64)
    span = 2 * round(2.0 * _REACH_M / _APART_M)  # two coordinates in one number
    keys = np.unique(places[:, 0] * span + places[:, 1] + span // 2)
    return np.column_stack([keys // span, keys % span - span // 2]) * _APART_M


def birds_eye_view(places_m: FloatArray, turn_deg: float = 0.0) -> Float32Array:
    """Return which cells around the sensor are occupied, `(160, 160)`, blurred.

    Args:
        places_m: `(n, 2)` metres, from `structure_m`.
        turn_deg: By which they are rotated, counter-clockwise.
    """
    x, y = places_m.T
    cos, sin = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    turned = np.stack([cos * x - sin * y, sin * x + cos * y])
    row, column = np.floor((turned + _REACH_M) / CELL_M).astype(np.int64)
    inside = (row >= 0) & (row < _CELLS) & (column >= 0) & (column < _CELLS)
    view = np.zeros((_CELLS, _CELLS), np.float32)
    view[row[inside], column[inside]] = 1.0
    blurred: Float32Array = gaussian_filter(view, _BLUR_CELLS, mode="constant")
    return blurred


def align_views(
    first: Scan, second: Scan, turns_deg: FloatArray, sensor_height_m: float
) -> Alignment:
    """Return the best alignment of two scans over some headings and all shifts within 5 m.

    Args:
        first: The scan that the answer is relative to.
        second: The other one.
        turns_deg: `(n,)` headings of the second relative to the first.
        sensor_height_m: Of both sensors above ground.
    """
    fixed = birds_eye_view(structure_m(first, sensor_height_m))
    places_m = structure_m(second, sensor_height_m)
    spectrum = fft.rfft2(fixed, (_PADDED, _PADDED))
    shifts = np.arange(-_MOST_CELLS, _MOST_CELLS + 1)
    best = Alignment(0.0, float(turns_deg[0]), 0.0, 0.0)
    for turn_deg in turns_deg.tolist():
        view = birds_eye_view(places_m, turn_deg)
        norm = float(np.linalg.norm(fixed) * np.linalg.norm(view))
        if norm == 0.0:
            continue
        turned = fft.rfft2(view, (_PADDED, _PADDED))
        product = fft.irfft2(spectrum * np.conj(turned), (_PADDED, _PADDED))
        near = product[np.ix_(shifts % _PADDED, shifts % _PADDED)]
        row, column = np.unravel_index(near.argmax(), near.shape)
        by_chance = float(np.median(near)) / norm
        overlap = (float(near[row, column]) / norm - by_chance) / max(1.0 - by_chance, _LEAST)
        if overlap > best.overlap:
            best = Alignment(
                min(1.0, overlap),
                turn_deg,
                float(shifts[row]) * CELL_M,
                float(shifts[column]) * CELL_M,
            )
    return best
