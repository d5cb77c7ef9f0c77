"""Progress reporting."""

from typing import Protocol


class Progress(Protocol):
    """Receives each stage of long work and every finished unit of it.

    Either method may raise `core.errors.Cancelled` to stop the work.
    """

    def start(self, stage: str, total: int) -> None:
        """A stage of `total` units begins; the one before is done."""

    def advance(self, units: int = 1) -> None:
        """`units` more of the stage are done."""


class _NoProgress:
    def start(self, stage: str, total: int) -> None:
        pass

    def advance(self, units: int = 1) -> None:
        pass


NO_PROGRESS: Progress = _NoProgress()
"""Nobody is listening."""
