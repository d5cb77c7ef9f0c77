"""The interface of a map's signatures as they are stored."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from core.arrays import Complex64Array, Float32Array, IntArray

if TYPE_CHECKING:
    from core.encodings.harmonic.codes import SignatureCodes


class StoredSignatures(ABC):
    """The signatures of all renderings of a map, which do not change."""

    @property
    @abstractmethod
    def shape(self) -> tuple[int, int, int, int]:
        """`(K, D, r1, r2)`."""

    @abstractmethod
    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return every array by its name in the file."""

    @property
    @abstractmethod
    def numbers(self) -> Complex64Array:
        """All of them as complex numbers, `(K, D, r1, r2)`."""

    @abstractmethod
    def at(self, rows: IntArray, renderings: IntArray | None = None) -> Complex64Array:
        """Return the signatures of some renderings, `(n, d, r1, r2)`.

        Args:
            rows: `(n,)` scans.
            renderings: `(n, d)` of each; all D by default.
        """

    @abstractmethod
    def select(self, rows: IntArray) -> "StoredSignatures":
        """Return those of some scans."""

    @abstractmethod
    def limited(self, r1: int) -> "StoredSignatures":
        """Return the first radial components; of codes in the same memory."""

    @abstractmethod
    def mixed(self, mixing: Float32Array) -> "StoredSignatures":
        """Return the signatures multiplied by a matrix, `(n, r1)`."""

    @abstractmethod
    def joined(self, others: Sequence["StoredSignatures"]) -> "StoredSignatures":
        """Return these and others, one after another: codes if some of them are."""

    @abstractmethod
    def as_codes(self) -> "SignatureCodes":
        """Return them as codes; numbers are rounded."""
