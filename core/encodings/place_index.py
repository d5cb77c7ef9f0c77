"""The interface of an index of many maps' places, by which the maps of a basis are searched."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, Generic, Self, TypeVar

from numpy.typing import NDArray

from core.arrays import Float32Array, FloatArray, IntArray
from core.encodings.basis import Basis
from core.encodings.model import Model
from core.encodings.signature import Signature


class PlaceEntries(ABC):
    """The places of some maps, map after map."""

    @abstractmethod
    def __len__(self) -> int: ...

    @abstractmethod
    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return every array by its name."""

    @abstractmethod
    def of_places(self, places: IntArray) -> dict[str, NDArray[Any]]:
        """Return the arrays of some places, from which entries can be listed again."""


Entries = TypeVar("Entries", bound=PlaceEntries)


class PlaceIndex(ABC, Generic[Entries]):
    """How the places of all maps of one basis are indexed and found."""

    @classmethod
    @abstractmethod
    def train(cls, basis: Basis, models: Sequence[Model], places: int) -> Self:
        """Return an index for maps of a basis, and places like those of some of them.

        Args:
            basis: Of the maps.
            models: Of some maps, at least one.
            places: How many there will be, about.
        """

    @classmethod
    @abstractmethod
    def of(cls, basis: Basis, arrays: Mapping[str, NDArray[Any]]) -> Self:
        """Return the index of these `arrays`."""

    @abstractmethod
    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return what is stored of the index besides its entries, by name."""

    @abstractmethod
    def entries(self, models: Sequence[Model]) -> Entries:
        """Return the entries of all scans of some maps."""

    @abstractmethod
    def read(self, arrays: Mapping[str, NDArray[Any]]) -> Entries:
        """Return stored entries of these `arrays`.

        Raises:
            InvalidMap: If they do not fit together.
            TypeError: If one is missing.
        """

    @abstractmethod
    def listed(self, arrays: Mapping[str, NDArray[Any]]) -> Entries:
        """Return entries with these arrays, and lists that are made of them."""

    @abstractmethod
    def candidates(
        self, entries: Entries, signature: Signature, places: IntArray | None = None
    ) -> tuple[IntArray, Float32Array]:
        """Return the places that a signature may be of, and how far their codes are from its own.

        Args:
            entries: Of some maps.
            signature: Of this basis.
            places: Those that may be found, rising; all without it.
        """

    @abstractmethod
    def most_alike(
        self, signature: Signature, found: Sequence[tuple[Entries, IntArray, Float32Array]]
    ) -> list[tuple[IntArray, FloatArray]]:
        """Compare the best candidates of several entries exactly.

        Args:
            signature: The query.
            found: Entries, and what `candidates` returned of them.

        Returns:
            For each of them, the places that were compared and their distances.
        """
