"""Images read block by block, so that a build never has all of them in memory."""

from collections.abc import Iterator

from core.arrays import Float32Array
from core.errors import InvalidImage
from core.progress import Progress
from core.projection.images import ImageSource

BLOCK_SCANS = 32  # 2.8 MB of float64 on the paper's grid: inside a cache, yet long enough for BLAS


def read_blocks(
    images: ImageSource, start: int, end: int, shape: tuple[int, ...], progress: Progress
) -> Iterator[tuple[int, Float32Array]]:
    """Yield the images `start` up to `end`, each block with the row of its first one.

    Args:
        images: The images of the whole map.
        start: Row of the first image.
        end: Row after the last.
        shape: The shape of one image, `(I, J)`, or `(D, I, J)` with renderings.
        progress: Receives every image.

    Raises:
        InvalidImage: If the source reads images of another number or shape.
    """
    for first in range(start, end, BLOCK_SCANS):
        last = min(first + BLOCK_SCANS, end)
        block = images.read(first, last)
        if block.shape != (last - first, *shape):
            raise InvalidImage(f"the images read {block.shape}, wanted {(last - first, *shape)}")
        yield first, block
        progress.advance(len(block))
