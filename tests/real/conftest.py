"""The folder of recorded drives that TENSORMAP_DATA names."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from core.scans.drive import Drive
from storage.formats.drives.layouts import open_drive


@pytest.fixture(scope="session")
def data_folder() -> Path:
    name = os.environ.get("TENSORMAP_DATA")
    if not name:
        pytest.skip("recorded drives are needed: TENSORMAP_DATA is not set")
    folder = Path(name)
    if not folder.is_dir():
        pytest.fail(f"TENSORMAP_DATA is {name}, which is no folder")
    return folder.resolve()


@pytest.fixture(scope="session")
def drives_folder(data_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of drives in the KITTI odometry layout; packed ones are unpacked."""
    unpack = data_folder / "unpack.py"
    if not unpack.is_file():
        return data_folder
    folder = tmp_path_factory.mktemp("drives")
    subprocess.run([sys.executable, unpack, folder], check=True, stdout=subprocess.DEVNULL)
    return folder


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


@pytest.fixture(scope="session")
def drives(drives_folder: Path) -> Drives:
    return Drives(drives_folder)
