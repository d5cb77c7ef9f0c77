"""Objects that are closed at the end of their `with` block."""

from abc import ABC, abstractmethod
from types import TracebackType
from typing import Self


class AsyncClosable(ABC):
    """An object that is closed at the end of its `with` block."""

    @abstractmethod
    async def close(self) -> None:
        """Close the object."""

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self.close()
