"""What an upload finds and does."""

from dataclasses import dataclass

_MOST_SKIPPED = 1000


@dataclass(frozen=True)
class StoredScans:
    """Which scans of a drive are stored.

    Attributes:
        ranges: First and last index of each run, ascending.
        closed: Whether the drive takes no more.
    """

    ranges: tuple[tuple[int, int], ...] = ()
    closed: bool = False

    @property
    def count(self) -> int:
        """The number of stored scans."""
        return sum(last - first + 1 for first, last in self.ranges)


@dataclass(frozen=True)
class Unusable:
    """A scan or file that the service did not store.

    Attributes:
        file: Its name, a scan's index.
        problem: The last word of its error's `type`.
        reason: What was expected and what was sent.
    """

    file: str
    problem: str
    reason: str


@dataclass(frozen=True)
class SkippedScan:
    """A scan that could not be stored, and why."""

    index: int
    reason: str


@dataclass
class Uploaded:
    """What an upload did.

    Attributes:
        scans: Of the drive.
        before: How many were stored before.
        stored: How many are new.
        sent_bytes: Of all that were sent, those that could not be stored included.
        skipped_scans: How many could not be stored.
        skipped: The first thousand of them.
        notes: Remarks of the service, as reasons for scans of a capture that it skipped.
        unused_files: Files beside the scans that could not be used, with the reason.
    """

    scans: int
    before: int
    stored: int = 0
    sent_bytes: int = 0
    skipped_scans: int = 0
    skipped: tuple[SkippedScan, ...] = ()
    unused_files: tuple[Unusable, ...] = ()
    notes: tuple[str, ...] = ()

    def skip(self, index: int, reason: str) -> None:
        """Count a scan that could not be stored."""
        self.skipped_scans += 1
        if len(self.skipped) < _MOST_SKIPPED:
            self.skipped = (*self.skipped, SkippedScan(index, reason))
