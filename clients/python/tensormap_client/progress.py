"""Progress of uploads and builds."""

from typing import Protocol


class Progress(Protocol):
    """Receives how far work is; its methods are called from one thread."""

    def start(self, stage: str, total: int) -> None:
        """Begin a stage of so many units."""

    def advance(self, units: int = 1) -> None:
        """So many units more are done."""

    def move_to(self, done: int) -> None:
        """Set how many units of the stage are done."""

    def sent(self, size_bytes: int) -> None:
        """So many more bytes were received by the service."""


class NoProgress:
    """A `Progress` that does nothing."""

    def start(self, stage: str, total: int) -> None:
        """Ignore it."""

    def advance(self, units: int = 1) -> None:
        """Ignore it."""

    def move_to(self, done: int) -> None:
        """Ignore it."""

    def sent(self, size_bytes: int) -> None:
        """Ignore it."""


NO_PROGRESS = NoProgress()
