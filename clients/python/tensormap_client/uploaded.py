"""Results of uploads."""

from dataclasses import dataclass

_MOST_SKIPPED = 1000


@dataclass(frozen=True)
class StoredScans:
    """Which scans of a drive are stored.

    Attributes:
        ranges: First and last index of each run, ascending.
        with_pose: The number of them that have a pose.
    """

    ranges: tuple[tuple[int, int], ...] = ()
    with_pose: int = 0

    @property
    def count(self) -> int:
        """The number of stored scans."""
        return sum(last - first + 1 for first, last in self.ranges)

    @property
    def samples(self) -> tuple[int, ...]:
        """Up to three of them: the first, the last, and the one half-way."""
        if not self.ranges:
            return ()
        half = self.count // 2
        for first, last in self.ranges:
            if half <= last - first:
                break
            half -= last - first + 1
        return tuple(sorted({self.ranges[0][0], first + half, self.ranges[-1][1]}))


@dataclass(frozen=True)
class Unusable:
    """A scan or file that the service did not store.

    Attributes:
        file: The file's name, or the scan's index.
        problem: The last part of the error's `type`.
        reason: What was wanted and what was received.
    """

    file: str
    problem: str
    reason: str


@dataclass(frozen=True)
class Put:
    """What the service did with the scans of a request.

    Attributes:
        present: Number of scans that were stored already.
        unusable: The scans that it did not store.
    """

    present: int = 0
    unusable: tuple[Unusable, ...] = ()


@dataclass(frozen=True)
class SkippedScan:
    """A scan that could not be stored, and why."""

    index: int
    reason: str


@dataclass
class Uploaded:
    """The result of an upload.

    Attributes:
        scans: Number of scans of the drive.
        before: Number of scans that were stored already: before, or meanwhile by another upload.
        stored: Number of newly stored scans.
        sent_bytes: Number of bytes sent, including scans that could not be stored.
        skipped_scans: Number of scans that could not be stored.
        skipped: The first thousand skipped scans.
        notes: Notes, for example why the service skipped scans of a capture, or that numbers of
            missing files get lost, or stored scans keep other poses than they have here.
        unused_files: Files beside the scans that could not be used, with reasons.
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
