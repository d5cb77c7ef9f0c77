"""What is closed at the end of a `with` block."""

from abc import ABC, abstractmethod
from typing import Self


class Closing(ABC):
    """Base of what holds a file, a process or a connection: a `with` block closes it."""

    @abstractmethod
    def close(self) -> None:
        """Let go of what is held; to do so twice is no error."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
