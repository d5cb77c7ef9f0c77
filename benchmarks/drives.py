"""Drives of which benchmarks read every scan many times."""

from core.scans.drive import Drive, MemoryDrive


def in_memory(drive: Drive, every: int = 1) -> MemoryDrive:
    """Return a drive of every n-th scan, all read."""
    return MemoryDrive(drive.name, [drive.scan(i) for i in range(0, len(drive), every)])
