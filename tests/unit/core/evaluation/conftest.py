"""Drives that several evaluations query."""

import pytest

from core.scans.drive import MemoryDrive
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor


def in_memory(**options):
    """Return a drive of a third of the usual returns, read once."""
    drive = SimulatedDrive(sensor=SimulatedSensor(firings=333), **options)
    return MemoryDrive(drive.name, list(drive))


@pytest.fixture(scope="module")
def drive():
    return in_memory(seed=3, scans=60, loop_m=250.0)


@pytest.fixture(scope="module")
def elsewhere():
    return in_memory(seed=8, scans=20)
