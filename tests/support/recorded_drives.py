"""Recorded drives, of the folder that TENSORMAP_DATA names."""

from pathlib import Path

import pytest

from core.scans.drive import Drive
from storage.formats.drives.layouts import open_drive


class Drives:
    """Recorded drives by name; one that is not there skips its test."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def path(self, name: str) -> Path:
        path = self._folder / name
        if not path.is_dir():
            pytest.skip(f"TENSORMAP_DATA has no drive {name}")
        return path

    def open(self, name: str) -> Drive:
        return open_drive(self.path(name), min_returns=100)
