"""Progress of uploads and builds."""

from typing import Protocol

HASHING = "hashing"
"""The stage before a capture is sent; nothing of it is kept."""


class Progress(Protocol):
    """Receives the progress of work; its methods are called from one thread."""

    def start(self, stage: str, total: int) -> None:
        """Begin a stage of `total` units of work."""

    def advance(self, units: int = 1) -> None:
        """Add finished units."""

    def move_to(self, done: int) -> None:
        """Set the number of finished units of the stage."""

    def sent(self, size_bytes: int) -> None:
        """Add bytes that the service received."""


class NoProgress:
    """A `Progress` that does nothing."""

    def start(self, stage: str, total: int) -> None:
        """Do nothing."""

    def advance(self, units: int = 1) -> None:
        """Do nothing."""

    def move_to(self, done: int) -> None:
        """Do nothing."""

    def sent(self, size_bytes: int) -> None:
        """Do nothing."""


NO_PROGRESS = NoProgress()
