"""Images, and how scans become images."""

import itertools
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import Any

import numpy as np

from core.arrays import Float32Array, freeze, frozen
from core.errors import InvalidImage, InvalidParameters, InvalidScan
from core.projection.angles import azimuth_columns
from core.projection.height_image import project_heights
from core.projection.levelling import level
from core.projection.range_image import project_scan
from core.projection.reducer import HEIGHT_REDUCERS, MOST_M, RANGE_REDUCERS, Reducer
from core.projection.rings import RingGrid
from core.projection.visibility import (
    FULL_VIEW,
    HIDDEN,
    View,
    hide,
    hide_with_sectors,
    visible_sectors,
)
from core.scans.displacement import seen_from_beside
from core.scans.scan import Scan
from core.scans.sensor import AngularGrid

Grid = AngularGrid | RingGrid

LATERAL_RENDERINGS_M = (-3.0, -1.5, 0.0, 1.5, 3.0)
"""Virtual viewpoints a lane to either side: docs/decisions/0010-harmonic-encoding.md."""

_MAX_LATERAL_M = 50.0
_MAX_RENDERINGS = 64
_MOST_MAPPED_M = 1e8  # with more the signatures of a map are too large, and it cannot be built


class Views(StrEnum):
    """Which views of places a map answers (docs/decisions/0030-any-view.md)."""

    FULL = "full"
    """Level scans that see all around, as those of the map."""
    ANY = "any"
    """Tilted ones too, and those from which a part of the place is hidden."""


class ImageKind(StrEnum):
    """The quantity in an image's cells."""

    RANGE = "range"
    HEIGHT = "height"


@dataclass(frozen=True, eq=False)
class Image:
    """A scan on a grid: a range image, the paper's matrix S, or a height image.

    Attributes:
        cells: `(I, J)` float32 metres up to 1e30, 0 where nothing is; one is above 0. In every row
            of a column of a height image that is hidden from the scan they are -1; a column hides
            its sector.
        grid: The lattice; an angular one has ranges, one of rings heights.
    """

    cells: Float32Array
    grid: Grid

    def __post_init__(self) -> None:
        shape = np.shape(self.cells)
        if shape != self.grid.shape:
            raise InvalidImage(f"the {self.kind} image has shape {shape}, wanted {self.grid.shape}")
        freeze(self, cells=np.float32)
        hidden = (self.cells[0] == HIDDEN) & (self.kind == ImageKind.HEIGHT)
        if not (self.cells <= MOST_M).all() or (self.cells[:, ~hidden] < 0).any():
            raise InvalidImage(
                f"the {self.kind} image has cells that are negative, above {MOST_M:g} or not finite"
            )
        if (self.cells[:, hidden] != HIDDEN).any():
            raise InvalidImage(f"the {self.kind} image has columns that are hidden in some rows")
        if hidden.any():  # a view has whole sectors: what is seen beside would be compared as 0
            object.__setattr__(self, "cells", frozen(hide_with_sectors(self.cells), np.float32))
        if (self.cells == HIDDEN).all():
            raise InvalidImage(f"the {self.kind} image has a hidden column in every sector")
        if not (self.cells > 0).any():
            raise InvalidImage(f"the {self.kind} image is empty: no cell is above 0")

    def __repr__(self) -> str:  # without the array
        shape, occupied_cells = self.cells.shape, self.occupied_cells
        return f"Image(kind={self.kind.value!r}, {shape=}, {occupied_cells=})"

    @property
    def kind(self) -> ImageKind:
        """The quantity in the cells."""
        return _kind_on(self.grid)

    @property
    def seen(self) -> Float32Array:
        """The cells, 0 in hidden columns."""
        return np.maximum(self.cells, 0.0)

    @property
    def occupied_cells(self) -> int:
        """How many cells have something in them."""
        return int(np.count_nonzero(self.seen))

    @cached_property
    def view(self) -> View:
        """The part that the scan saw; a range image's is the whole."""
        return View.of(self.cells) if self.kind == ImageKind.HEIGHT else FULL_VIEW


@dataclass(frozen=True)
class Imager:
    """The parameters of an image besides its scan.

    Attributes:
        grid: The lattice; an angular one is for range images, one of rings for height images.
        reducer: What a shared cell keeps.
        sensor_height_m: Height of the sensor above ground; only height images depend on it.
        lateral_renderings_m: `D` viewpoints, metres to the left, from which a scan of the map is
            rendered; `None` for the recorded one only.
        views: Which scans it expects; with `any` they are levelled, and hidden columns marked.
    """

    grid: Grid
    reducer: Reducer
    sensor_height_m: float = 0.0
    lateral_renderings_m: tuple[float, ...] | None = None
    views: Views = Views.FULL

    def __post_init__(self) -> None:
        allowed = HEIGHT_REDUCERS if self.kind == ImageKind.HEIGHT else RANGE_REDUCERS
        if self.reducer not in allowed:
            raise InvalidParameters(
                f"reducer is {self.reducer}, wanted {', '.join(allowed)} for a {self.kind} image"
            )
        offsets = self.lateral_renderings_m
        if offsets is None:
            return
        # 0 and -0.0 are one place, and must be one digest.
        offsets = tuple(float(offset) + 0.0 for offset in offsets)
        object.__setattr__(self, "lateral_renderings_m", offsets)
        if not 1 <= len(offsets) <= _MAX_RENDERINGS:
            raise InvalidParameters(
                f"lateral_renderings_m has {len(offsets)} offsets, wanted 1..{_MAX_RENDERINGS}"
            )
        if not all(abs(offset) <= _MAX_LATERAL_M for offset in offsets) or not all(
            one < two for one, two in itertools.pairwise(offsets)
        ):
            raise InvalidParameters(
                f"lateral_renderings_m is {list(offsets)}, wanted rising metres within"
                f" {_MAX_LATERAL_M:g}"
            )

    @property
    def kind(self) -> ImageKind:
        """The quantity in the cells."""
        return _kind_on(self.grid)

    @property
    def shape(self) -> tuple[int, ...]:
        """`(I, J)`, or `(D, I, J)` with lateral renderings: of a scan of the map."""
        if self.lateral_renderings_m is None:
            return self.grid.shape
        return len(self.lateral_renderings_m), *self.grid.shape

    def image(self, scan: Scan, sensor_height_m: float | None = None) -> Image:
        """Return a scan's image.

        Args:
            scan: The returns.
            sensor_height_m: The height of this scan's sensor, if it is not the map's.

        Raises:
            InvalidScan: If no return falls inside the grid, or all on the ground.
        """
        return self._image(self._levelled(scan, sensor_height_m), sensor_height_m)

    def render(self, scan: Scan) -> Float32Array:
        """Return the image or renderings of a scan of the map, of `shape`.

        Raises:
            InvalidScan: If one of the images would be empty, or a return is so far away or high
                that no sensor measures it.
        """
        levelled = self._levelled(scan, None)
        rendered = np.stack(
            [
                self._image(_beside(levelled, left_m) if left_m else levelled, None).cells
                for left_m in self.lateral_renderings_m or (0.0,)
            ]
        )
        if (largest_m := float(rendered.max())) > _MOST_MAPPED_M:
            raise InvalidScan(
                f"a return is {largest_m:.3g} m away or high, wanted at most {_MOST_MAPPED_M:g} m"
            )
        return rendered[0] if self.lateral_renderings_m is None else rendered

    def _levelled(self, scan: Scan, sensor_height_m: float | None) -> Scan:
        return scan if self.views == Views.FULL else level(scan, self._height_m(sensor_height_m))

    def _height_m(self, given_m: float | None) -> float:
        return self.sensor_height_m if given_m is None else given_m

    def _image(self, levelled: Scan, sensor_height_m: float | None) -> Image:
        if isinstance(self.grid, AngularGrid):
            return Image(project_scan(levelled, self.grid, self.reducer), self.grid)
        height_m = self._height_m(sensor_height_m)
        if self.views == Views.FULL:
            return Image(project_heights(levelled, self.grid, self.reducer, height_m), self.grid)
        points_m, columns = levelled.points_m, self.grid.columns
        column = azimuth_columns(points_m, columns)
        cells = project_heights(levelled, self.grid, self.reducer, height_m, column)
        cells = hide(cells, visible_sectors(points_m, column, columns))
        if not (cells > 0).any():
            raise InvalidScan(f"none of the {len(levelled)} returns is above ground where it sees")
        return Image(cells, self.grid)

    def as_attributes(self) -> dict[str, Any]:
        """Return the parameters of a rendering, as plain values."""
        attributes: dict[str, Any] = {
            "grid": self.grid.as_attributes(),
            "reducer": self.reducer.value,
        }
        if self.kind == ImageKind.HEIGHT:
            attributes["sensor_height_m"] = self.sensor_height_m
        if self.lateral_renderings_m is not None:
            attributes["lateral_renderings_m"] = list(self.lateral_renderings_m)
        if self.views != Views.FULL:  # which is what the names of older files do not say
            attributes["views"] = self.views.value
        return attributes


def grid_from_attributes(attributes: dict[str, Any]) -> Grid:
    """Read a grid of either kind.

    Raises:
        InvalidParameters: If a value is out of its range.
        TypeError: If a value is missing or of neither kind.
    """
    return RingGrid(**attributes) if "rings" in attributes else AngularGrid(**attributes)


def _kind_on(grid: Grid) -> ImageKind:
    return ImageKind.HEIGHT if isinstance(grid, RingGrid) else ImageKind.RANGE


def _beside(scan: Scan, left_m: float) -> Scan:
    return Scan.from_returns(seen_from_beside(scan.points_m, left_m))
