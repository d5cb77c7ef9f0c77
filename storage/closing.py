"""Base of classes that a `with` block closes."""

from abc import ABC, abstractmethod
from typing import Self


class Closing(ABC):
    """Holds a file, a process or a connection, which a `with` block closes."""

    @abstractmethod
    def close(self) -> None:
        """Release what is held; a second call is no error."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
