"""The folder of recorded drives that TENSORMAP_DATA names."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.locks import one_at_a_time
from tests.support.recorded_drives import Drives

_SHORT = ("test_axes", "test_poses", "test_client", "test_native", "test_uploads")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """End with the modules whose tests are short: others leave a worker without one for longer."""
    items.sort(key=lambda item: item.path.name.startswith(_SHORT))


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
def drives_folder(data_folder: Path, shared: Path) -> Path:
    """A folder of drives in the KITTI odometry layout; packed ones are unpacked."""
    unpack = data_folder / "unpack.py"
    if not unpack.is_file():
        return data_folder
    folder, unpacked = shared / "drives", shared / "drives.unpacked"
    with one_at_a_time(shared / "drives.lock"):
        if not unpacked.exists():
            subprocess.run([sys.executable, unpack, folder], check=True, stdout=subprocess.DEVNULL)
            unpacked.touch()
    return folder


@pytest.fixture(scope="session")
def drives(drives_folder: Path, shared: Path) -> Drives:
    return Drives(drives_folder, shared)
