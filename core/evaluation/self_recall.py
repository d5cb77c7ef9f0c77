"""Self-recall: whether a map finds its own scans, seen from elsewhere.

The queries are the probes that calibrate it: its scans with relative yaw, lateral offset,
occlusion and noise, each searched for without itself. So the recall of two maps of the same scans
can be compared without a second drive.
"""

from collections.abc import Sequence

import numpy as np

from core.arrays import BoolArray
from core.confidence.places import AWAY_M
from core.mapping.own_place import RIGHT_SCANS, image_of, own_place
from core.mapping.tensormap import TensorMap
from core.projection.images import ImageSource
from core.projection.probe import LEFT_OUT_M

CRITERION = (
    f"the matched scan was recorded within {AWAY_M:g} m of the query; what was recorded within"
    f" {LEFT_OUT_M:g} m of it is not searched. Where poses are unknown: within {RIGHT_SCANS} scans,"
    " and not itself"
)
"""What counts as right, in words."""


def is_findable(tensor_map: TensorMap, row: int) -> bool:
    """Return whether any other scan of the map would be a right answer to scan `row`."""
    return bool(own_place(tensor_map.trajectory, row)[1].any())


def finds_own(
    tensor_map: TensorMap, rows: Sequence[int], probes: Sequence[tuple[ImageSource, int]]
) -> BoolArray:
    """Query a map with some of its own scans.

    Args:
        tensor_map: The map.
        rows: n of its scans.
        probes: For each scan, where the image of its probe is: a source on the map's grid, and its
            position there.

    Returns:
        `(n,)` whether the nearest scan is a right one.
    """
    basis = tensor_map.basis()
    right = np.zeros(len(rows), np.bool_)
    for query, (row, (images, position)) in enumerate(zip(rows, probes, strict=True)):
        among, near = own_place(tensor_map.trajectory, row)
        if near.any():
            image = image_of(tensor_map, images, position)
            # As of a vehicle that sends a signature: scans find more.
            search = tensor_map.model.search_values(basis.project(image), basis.view(image))
            found = search.nearest(1, among)
            right[query] = near[found.rows[0]]
    return right
