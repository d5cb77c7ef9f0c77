"""The Gram matrix of the detail in each drive's images, to which a radial basis is fitted."""

from collections.abc import Mapping

import numpy as np

from core.arrays import BoolArray, Float32Array, FloatArray
from core.encodings.blocks import BLOCK_SCANS
from core.encodings.harmonics import azimuth_factor, weights
from core.encodings.tucker import leading_basis, row_gram
from core.errors import InvalidImage
from core.progress import NO_PROGRESS, Progress
from core.projection.images import ImageSource

_DETAIL_DEG = 24.0  # finer than this is detail: J / 15 columns, the waves from harmonic 15 on
_TIES = 1e-6  # of the whole image's Gram: it decides where an image has no detail


def detail_gram(images: Float32Array | FloatArray) -> FloatArray:
    """Return the Gram matrix whose leading eigenvectors are U, of `(n, I, J)` images, `(I, I)`.

    It is S S^T without the waves longer than 24 degrees. Broad waves have the most energy: heights
    of rings that every street has. A basis fitted to them describes all places alike; one fitted to
    edges and poles keeps the rings in which places differ, and its signatures differ too, although
    they contain broad waves only. The sum is additive over images and does not depend on their yaw,
    but for rounding.

    Examples:
        >>> edge, even = np.zeros((2, 1, 2, 360))
        >>> edge[0, 0, :9], even[0, 1] = 1.0, 5.0
        >>> gram = detail_gram(np.stack([edge[0] + even[0]]))
        >>> bool(gram[0, 0] > 100 * gram[1, 1])
        True
    """
    columns = images.shape[2]
    broadest = max(1, min(round(360.0 / _DETAIL_DEG), columns // 2))
    factor = azimuth_factor(columns, broadest) * np.sqrt(weights(columns, broadest))
    broad = np.concatenate([factor.real, factor.imag[:, 1:]], axis=1)
    whole = row_gram(images)
    return whole * (1.0 + _TIES) - row_gram(images.astype(np.float64) @ broad)


def drive_gram(
    images: ImageSource, start: int, counted: BoolArray, progress: Progress = NO_PROGRESS
) -> FloatArray:
    """Return `detail_gram` of images, or all renderings, of one drive, `(I, I)`.

    One scan of each stand counts: by all of them a basis would be fitted to the places where the
    vehicle waited.

    It is summed in blocks that begin at the drive's first scan, so it is the same to the bit
    whether the drive is read alone or among others, and in any worker.

    Args:
        images: The images of one or more drives.
        start: Row of the drive's first scan.
        counted: `(n,)` which of its scans count, see `first_of_stands`.
        progress: Receives every scan.

    Raises:
        InvalidImage: If the source reads images of another shape than its grid's.
    """
    rows, columns = images.grid.shape
    gram = np.zeros((rows, rows))
    for first in range(0, len(counted), BLOCK_SCANS):
        these = counted[first : first + BLOCK_SCANS]
        progress.advance(len(these))
        if not these.any():
            continue
        block = images.read(start + first, start + first + len(these))
        if block.shape[-2:] != (rows, columns):
            raise InvalidImage(f"the images read {block.shape}, the grid is {rows} x {columns}")
        gram += detail_gram(np.maximum(block[these], 0.0).reshape(-1, rows, columns))
    return gram


def sum_of_grams(grams: Mapping[str, FloatArray]) -> FloatArray:
    """Return the sum over drives, added in the order of their names.

    Floating-point sums depend on their order; this one does not depend on the order of drives in
    the map or of workers.

    Examples:
        >>> one, two, three = (np.full((1, 1), x) for x in (0.1, 0.2, 0.3))
        >>> forth = sum_of_grams({"a": one, "b": two, "c": three})
        >>> bool(forth == sum_of_grams({"c": three, "b": two, "a": one}))
        True
    """
    names = sorted(grams)
    total = grams[names[0]].copy()
    for name in names[1:]:
        total += grams[name]
    return total


def fit_radial_basis(grams: Mapping[str, FloatArray], rank: int) -> Float32Array:
    """Return U of all drives, `(I, rank)` float32, orthonormal columns.

    Raises:
        InvalidParameters: If `rank` is not within 1..I.
    """
    return leading_basis(sum_of_grams(grams), rank).astype(np.float32)


def radial_error(gram: FloatArray, u: Float32Array | FloatArray) -> float:
    """Return the share of the detail in all summed images that U leaves out, 0..1.

    |D - U U^T D| / |D|, D being the images without their broad waves.

    Examples:
        >>> radial_error(np.diag([9.0, 16.0]), np.eye(2)[:, 1:])
        0.6
    """
    whole = float(np.trace(gram))
    if whole <= 0.0:
        return 0.0
    basis = u.astype(np.float64)
    kept = float(np.einsum("ir,ij,jr->", basis, gram, basis))
    return float(np.sqrt(max(0.0, 1.0 - kept / whole)))
