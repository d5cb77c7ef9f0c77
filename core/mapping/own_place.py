"""Queries of a map with its own scans: which scans are searched, and which are right.

A vehicle is never exactly where a scan was recorded, so the scan itself, and what was recorded
within a metre of it, is not searched. What was recorded within `AWAY_M` of it is right.
"""

from core.arrays import BoolArray
from core.confidence.places import AWAY_M, away_from, comparable_with
from core.mapping.tensormap import TensorMap
from core.projection.imager import Image
from core.projection.images import ImageSource
from core.projection.probe import LEFT_OUT_M
from core.scans.trajectory import Trajectory

RIGHT_SCANS = 15
"""Where poses are unknown, as `AWAY_M` is where they are known."""

_LEFT_OUT_SCANS = 1  # where poses are unknown, as `LEFT_OUT_M` is where they are known


def own_place(trajectory: Trajectory, row: int) -> tuple[BoolArray, BoolArray]:
    """Return which scans are searched for a probe of scan `row`, and which of them are right.

    Scans of which it is not known how far they are from it are not searched.

    Args:
        trajectory: K scans.
        row: The row of the probe's scan.

    Returns:
        `(K,)` the others but for what was recorded beside it, and `(K,)` those of them that were
        recorded near.
    """
    searched = away_from(trajectory, row, LEFT_OUT_M, _LEFT_OUT_SCANS)
    searched &= comparable_with(trajectory, row)
    return searched, searched & ~away_from(trajectory, row, AWAY_M, RIGHT_SCANS)


def image_of(tensor_map: TensorMap, images: ImageSource, position: int) -> Image:
    """Return one image of a source on the map's grid, without renderings, as a query is."""
    return Image(images.read(position, position + 1)[0], tensor_map.parameters.grid)
