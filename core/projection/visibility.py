"""Which way a scan sees: sectors of azimuth that something near hides, or that no return covers.

A truck beside the vehicle, a narrow sensor or its mounting hide a part of a place. An image marks
the columns of hidden sectors, and a query is compared with a map only where it sees. The sectors
travel with a signature, 60 bits (docs/reference/signature.md).
"""

import numpy as np

from core.arrays import BoolArray, Float32Array, IntArray
from core.projection.angles import azimuth_steps

SECTORS = 60
"""Of 6 degrees each; sector 0 begins with the first column of an image."""

HIDDEN = np.float32(-1.0)
"""The cells of a hidden column."""

_FAR_M = 6.0  # a truck in the next lane is nearer, most walls are not
_FEWEST = 10  # sectors: 60 degrees


def sector_of_column(columns: int) -> IntArray:
    """Return the sector of each of J columns, floor(60 j / J), `(J,)`."""
    return np.arange(columns, dtype=np.int64) * SECTORS // columns


def visible_sectors(points_m: Float32Array, columns: int) -> BoolArray:
    """Return which sectors a scan sees: at least half of their columns have a return beyond 6 m.

    Where fewer than 10 are left, as in a tunnel or of a scan of few returns, those with any return
    are visible: everything there is near.

    Args:
        points_m: `(n, 3)` returns.
        columns: J, the azimuths of an image.

    Returns:
        `(60,)`.

    Examples:
        >>> azimuth = np.radians(np.arange(360.0))
        >>> ring_m = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(360)], 1)
        >>> wall_m = np.where(np.abs(azimuth - np.pi)[:, None] < 2.0, 5.0, 7.0) * ring_m
        >>> int(visible_sectors(wall_m, 360).sum()), int(visible_sectors(ring_m, 360).sum())
        (22, 60)
    """
    x, y = points_m[:, 0].astype(np.float64), points_m[:, 1].astype(np.float64)
    column = azimuth_steps(x, y, 360.0 / columns) % columns
    sees = np.zeros(columns, dtype=np.int64)
    sees[column[x * x + y * y > _FAR_M * _FAR_M]] = 1
    sector = sector_of_column(columns)
    wide = np.maximum(np.bincount(sector, minlength=SECTORS), 1)
    visible: BoolArray = 2 * np.bincount(sector, sees, SECTORS) >= wide
    if np.count_nonzero(visible) < _FEWEST:
        visible = np.bincount(sector[column], minlength=SECTORS) > 0
    return visible


def hide(cells: Float32Array, visible: BoolArray) -> Float32Array:
    """Return `(I, J)` cells with the columns of sectors that are not visible marked as hidden."""
    columns = visible[sector_of_column(cells.shape[-1])]
    return np.where(columns, cells, HIDDEN)


def hidden_sectors(cells: Float32Array) -> tuple[int, ...]:
    """Return the sectors whose columns are marked as hidden in `(I, J)` cells."""
    hidden = np.unique(sector_of_column(cells.shape[-1])[cells[0] < 0])
    return tuple(hidden.tolist())


def bits_of_hidden(cells: Float32Array) -> IntArray:
    """Return the hidden sectors of `(..., I, J)` images as bits, sector s being bit s, `(...)`."""
    columns = cells.shape[-1]
    first = np.searchsorted(sector_of_column(columns), np.arange(SECTORS)).clip(max=columns - 1)
    hidden = (cells[..., 0, :] < 0)[..., first].astype(np.int64)
    return np.asarray(hidden @ (1 << np.arange(SECTORS, dtype=np.int64)))


def seen_of_bits(bits: IntArray, columns: int) -> BoolArray:
    """Return which columns are seen, of `(...)` bits of hidden sectors, `(..., J)`."""
    seen: BoolArray = bits[..., None] >> sector_of_column(columns) & 1 == 0
    return seen
