"""The cells of an image of a scan: float32, finite, and not all empty."""

import numpy as np

from core.arrays import Float32Array, frozen
from core.errors import InvalidImage


def checked_cells(name: str, cells: Float32Array, shape: tuple[int, ...]) -> Float32Array:
    """Return the cells of an image, frozen.

    Args:
        name: Of the image's attribute, for errors.
        cells: Its values.
        shape: Of its grid.

    Raises:
        InvalidImage: If they have another shape, are not finite, negative, or all 0.
    """
    values = np.asarray(cells)
    if values.shape != shape:
        raise InvalidImage(f"{name} has shape {values.shape}, the grid has {shape}")
    values = frozen(values, np.float32)
    if not np.isfinite(values).all() or (values < 0).any():
        raise InvalidImage(f"{name} holds values that are not finite or are negative")
    if not values.any():
        raise InvalidImage(f"{name} is empty: every cell is 0")
    return values
