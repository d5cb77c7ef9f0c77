"""The view of a scan: sectors of azimuth that are hidden from it, and rings within its reach.

A truck beside the vehicle, a narrow sensor or its mounting hide a part of a place, and rain or a
small sensor end before others do. An image marks the columns of hidden sectors, and a query is
compared with a map only where it sees. The view travels with a signature, 8 bytes
(docs/reference/signature.md).
"""

import operator
from dataclasses import dataclass

import numpy as np

from core.arrays import BoolArray, Float32Array, IntArray
from core.errors import InvalidSignature
from core.projection.blocks import blocks

SECTORS = 60
"""Sectors of 6 degrees; sector 0 begins with the first column of an image."""

HIDDEN = np.float32(-1.0)
"""The cells of a hidden column."""

MOST_RINGS = 15
"""To which a view is limited at most: beyond, and in all other scans, no ring is left out."""

_FAR_M = 6.0  # a truck in the next lane is nearer, most walls are not
_FEWEST = 10  # sectors: 60 degrees
_FEWEST_RINGS = 3
_SHORT = 0.6  # of the rings: what ends before has a short reach


@dataclass(frozen=True)
class View:
    """The part of an image that a scan sees.

    Attributes:
        hidden: Sectors of azimuth that it does not see, rising.
        rings: How many rings, from the sensor on, are within its reach; `None` if all are.
    """

    hidden: tuple[int, ...] = ()
    rings: int | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "hidden", tuple(map(operator.index, self.hidden)))
        if self.rings is not None:
            object.__setattr__(self, "rings", operator.index(self.rings))
            if not 1 <= self.rings <= MOST_RINGS:
                raise InvalidSignature(f"rings is {self.rings}, wanted 1..{MOST_RINGS}")
        if wrong := set(self.hidden) - set(range(SECTORS)):
            raise InvalidSignature(f"sector {min(wrong)} is hidden, wanted 0..{SECTORS - 1}")
        if len(self.hidden) >= SECTORS:
            raise InvalidSignature(
                f"{len(self.hidden)} sectors are hidden, wanted fewer than {SECTORS}"
            )
        if list(self.hidden) != sorted(set(self.hidden)):
            raise InvalidSignature("hidden sectors do not rise")

    @property
    def is_full(self) -> bool:
        """Whether it leaves nothing out."""
        return self == FULL_VIEW

    @property
    def is_narrow(self) -> bool:
        """Whether it leaves out a third of the azimuths or more, or rings."""
        return 3 * len(self.hidden) >= SECTORS or self.rings is not None

    @property
    def has_short_reach(self) -> bool:
        """Whether it leaves out rings all around, as of a sensor of short range.

        How far a narrow view reaches depends on what stands there.

        Examples:
            >>> View(rings=6).has_short_reach, View(tuple(range(40)), rings=6).has_short_reach
            (True, False)
        """
        return self.rings is not None and 3 * len(self.hidden) < SECTORS

    def share_of(self, rings: int) -> float:
        """Return the share of the cells of an image of so many rings that it sees.

        Examples:
            >>> View(tuple(range(30)), rings=10).share_of(20)
            0.25
        """
        within = rings if self.rings is None else min(self.rings, rings)
        return (1.0 - len(self.hidden) / SECTORS) * within / rings

    @classmethod
    def of(cls, cells: Float32Array) -> "View":
        """Return the view of an image, `(I, J)` cells."""
        return cls(hidden_sectors(cells), rings_in_reach(cells))

    @classmethod
    def of_bits(cls, bits: int) -> "View":
        """Return the view whose `bits` these are."""
        hidden = tuple(sector for sector in range(SECTORS) if bits >> sector & 1)
        return cls(hidden, (bits >> SECTORS) or None)

    @property
    def bits(self) -> int:
        """A number of 64 bits: bit s is hidden sector s, the upper four are the rings, 0 for all.

        Examples:
            >>> view = View((0, 2), rings=5)
            >>> hex(view.bits), View.of_bits(view.bits) == view
            ('0x5000000000000005', True)
        """
        return sum(1 << sector for sector in self.hidden) + ((self.rings or 0) << SECTORS)


FULL_VIEW = View()
"""The view of a scan that sees all around."""


def sector_of_column(columns: int) -> IntArray:
    """Return the sector of each of J columns, floor(60 j / J), `(J,)`."""
    return np.arange(columns, dtype=np.int64) * SECTORS // columns


def visible_sectors(points_m: Float32Array, column: IntArray, columns: int) -> BoolArray:
    """Return which sectors a scan sees: at least half of their columns have a return beyond 6 m.

    Where fewer than 10 are left, as in a tunnel or of a scan of few returns, those with any return
    are visible: everything there is near.

    Args:
        points_m: `(n, 3)` returns.
        column: `(n,)` column of each, as of `azimuth_columns`.
        columns: J, the azimuths of an image.

    Returns:
        `(60,)`.

    Examples:
        >>> azimuth = np.radians(np.arange(360.0))
        >>> ring_m = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(360)], 1)
        >>> wall_m = np.where(np.abs(azimuth - np.pi)[:, None] < 2.0, 5.0, 7.0) * ring_m
        >>> column = np.arange(360)
        >>> [int(visible_sectors(m, column, 360).sum()) for m in (wall_m, ring_m)]
        [22, 60]
    """
    sees = np.zeros(columns, dtype=np.bool_)
    for block in blocks(points_m):
        x, y = points_m[block, :2].T.astype(np.float64, order="C")
        sees[column[block][x * x + y * y > _FAR_M * _FAR_M]] = True
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


def hide_with_sectors(cells: Float32Array) -> Float32Array:
    """Return `(I, J)` cells in which the sectors of the hidden columns are hidden as a whole."""
    visible = np.ones(SECTORS, dtype=np.bool_)
    visible[list(hidden_sectors(cells))] = False
    return hide(cells, visible)


def hidden_sectors(cells: Float32Array) -> tuple[int, ...]:
    """Return the sectors whose columns are marked as hidden in `(I, J)` cells."""
    hidden = np.unique(sector_of_column(cells.shape[-1])[cells[0] < 0])
    return tuple(hidden.tolist())


def rings_in_reach(cells: Float32Array) -> int | None:
    """Return how many rings of `(I, J)` cells lie within the reach of their scan, `None` if all do.

    Nothing is above the ground beyond the last ring in which something is, and that one is seen in
    part. Where it is one of the outer 40 percent, the scan is not short of reach: in most places
    something stands between 48 and 80 m.

    Examples:
        >>> far, near = np.zeros((2, 20, 360), np.float32)
        >>> far[12], near[7] = 1.0, 1.0
        >>> rings_in_reach(far), rings_in_reach(near)
        (None, 7)
    """
    last = int(np.flatnonzero((cells > 0).any(axis=1))[-1])
    if last >= _SHORT * len(cells) or last > MOST_RINGS:
        return None
    return min(max(last, _FEWEST_RINGS), len(cells))


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
