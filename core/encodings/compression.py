"""The compression of a TensorMap against its images and returns (paper, sec. 3.5)."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Compression:
    """Numbers in the map, and the ratios of those of the images and of the returns.

    Examples:
        The paper's own figures, K = 3800 scans of 77,000 returns in 5 segments:

        >>> Compression.of(104_775, scans=3800, grid_shape=(30, 361), returns=3800 * 77_000)
        Compression(elements=104775, tensor_ratio=392.784..., returns_ratio=8377.95...,
                    verification_bytes=0)

    Attributes:
        elements: Numbers of bases and signatures.
        tensor_ratio: Numbers of the images, for each of them.
        returns_ratio: Numbers of the returns, likewise.
        verification_bytes: The size of verification images, which are no elements.
    """

    elements: int
    tensor_ratio: float
    returns_ratio: float
    verification_bytes: int = 0

    @classmethod
    def of(
        cls,
        elements: int,
        *,
        scans: int,
        grid_shape: tuple[int, int],
        returns: int,
        verification_bytes: int = 0,
    ) -> "Compression":
        """Compare `elements` with the image tensor and with returns of three numbers each."""
        rows, columns = grid_shape
        of_tensor, of_returns = rows * columns * scans / elements, 3 * returns / elements
        return cls(elements, of_tensor, of_returns, verification_bytes)
