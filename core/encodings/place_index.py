"""The interface of an index of many maps' places, by which the maps of a basis are searched."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, Generic, Self, TypeVar

from numpy.typing import NDArray

from core.arrays import FloatArray, IntArray
from core.encodings.basis import Basis
from core.encodings.model import Model
from core.encodings.signature import Signature
from core.projection.imager import Image


class PlaceEntries(ABC):
    """The places of some maps, map after map."""

    @abstractmethod
    def __len__(self) -> int: ...

    @abstractmethod
    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return every array by its name."""

    @abstractmethod
    def select(self, spans: IntArray) -> Self:
        """Return the places of some ranges, `(n, 2)` first place and end of each."""


Entries = TypeVar("Entries", bound=PlaceEntries)


class PlaceIndex(ABC, Generic[Entries]):
    """How the places of all maps of one basis are indexed and found."""

    @classmethod
    @abstractmethod
    def of(cls, basis: Basis) -> Self:
        """Return the index for maps of a basis."""

    @abstractmethod
    def entries(self, models: Sequence[Model]) -> Entries:
        """Return the entries of all scans of some maps."""

    @abstractmethod
    def joined(self, parts: Sequence[Entries]) -> Entries:
        """Return the places of some entries, one after another."""

    @abstractmethod
    def read(self, arrays: Mapping[str, NDArray[Any]]) -> Entries:
        """Return stored entries of these `arrays`.

        Raises:
            InvalidMap: If they do not fit together or the basis.
            TypeError: If one is missing.
        """

    @abstractmethod
    def nearest(
        self,
        query: Signature | Image,
        searched: Sequence[tuple[Entries, IntArray | None]],
    ) -> list[tuple[IntArray, FloatArray]]:
        """Compare the places that a query may be of exactly.

        Args:
            query: A signature of this basis, or an image on its grid: the best places are compared
                with its cells where all of them have a verification image.
            searched: Entries, and the ranges of their places that may be found, `(n, 2)`, rising;
                `None` of all. No other place is read.

        Returns:
            For each of them, the places that were compared and their distances.
        """
