"""The wheels have all that a service or a client needs: they run from an empty folder."""

import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
import venv
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import distribution
from pathlib import Path
from zipfile import ZipFile

import httpx2
import numpy as np
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from tensormap_client import Mapper

from tests.support.locks import one_at_a_time

ROOT = Path(__file__).parents[2]
PACKAGES = ("app", "baselines", "core", "storage")


@dataclass(frozen=True)
class Installed:
    """The wheels, and environments where nothing but they are installed."""

    wheel: Path
    client: Path
    folder: Path

    @property
    def command(self) -> Path:
        return self.folder / "env/bin/tensormap"

    @property
    def environment(self) -> dict[str, str]:
        # The dependencies come from the environment that runs this test; what points from there
        # to our own source (.pth) counts in site folders only, not on PYTHONPATH.
        kept = {k: v for k, v in os.environ.items() if not k.startswith("TENSORMAP_")}
        return kept | {"PYTHONPATH": str(Path(np.__file__).parents[1])}


@pytest.fixture(scope="module")
def installed(shared: Path) -> Installed:
    folder, done = shared / "wheels", shared / "wheels.done"
    with one_at_a_time(shared / "wheels.lock"):
        if not done.exists():
            make_wheels(folder)
            wheel, client = wheels_in(folder)
            install(folder / "env", client, wheel)
            install(folder / "vehicle", client)
            done.touch()
    return Installed(*wheels_in(folder), folder)


def make_wheels(folder: Path) -> None:
    source = folder / "source"
    source.mkdir(parents=True)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    for name in PACKAGES:
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "clients/python", source / "clients/python")
    subprocess.run(
        [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--wheel-dir", str(folder)]
        + (["--no-build-isolation"] if shutil.which("hatchling", path=_bin()) else [])
        + ["clients/python", "."],
        cwd=source,
        check=True,
    )
    shutil.rmtree(source)


def wheels_in(folder: Path) -> tuple[Path, Path]:
    """Return the wheels of the service and of the client."""
    (wheel,), (client,) = folder.glob("tensormap_server*.whl"), folder.glob("tensormap_client*.whl")
    return wheel, client


def install(environment: Path, *wheels: Path) -> None:
    """Make an environment of nothing but these wheels."""
    venv.create(environment, with_pip=False)
    python = str(environment / "bin/python")
    pip = [sys.executable, "-m", "pip", "--python", python]
    # What is imported is compiled then: that is a third of it.
    subprocess.run([*pip, "install", "-q", "--no-deps", "--no-compile", *wheels], check=True)


def link_needed(of: str, folder: Path) -> set[str]:
    """Link the packages that a distribution needs, and nothing else; return their names."""
    wanted: list[str] = [of]
    found = {of}
    while wanted:
        for line in distribution(wanted.pop()).requires or ():
            needed = Requirement(line)
            name = canonicalize_name(needed.name)
            if name in found or (needed.marker and not needed.marker.evaluate({"extra": ""})):
                continue
            found.add(name)
            wanted.append(name)
    for package in map(distribution, found - {of}):
        for top in {file.parts[0] for file in package.files or ()} - {"..", "__pycache__"}:
            (folder / top).symlink_to(Path(str(package.locate_file(top))))
    return found - {of}


def _bin() -> str:
    return str(Path(sys.executable).parent)


@contextmanager
def serving(installed: Installed, folder: Path, data: str) -> Iterator[str]:
    """Run the installed service on a free port; yields the address that it prints."""
    process = subprocess.Popen(
        [installed.command, "serve", "--port", "0", "--data", data],
        cwd=folder,
        env=installed.environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    watchdog = threading.Timer(60, process.kill)
    watchdog.start()
    try:
        shown = ""
        for line in process.stderr:
            shown += line
            if "startup complete" in line:
                url = re.findall(r"TensorMap at (http://\S+)", shown)[0]
                _wait_until_it_listens(url)
                yield url
                break
        else:
            pytest.fail(f"the service did not start:\n{shown}")
    finally:
        watchdog.cancel()
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=30)


def _wait_until_it_listens(url: str) -> None:
    for _ in range(100):
        with contextlib.suppress(httpx2.TransportError):
            httpx2.get(f"{url}/livez")
            return
        time.sleep(0.1)


def write_scans(folder: Path) -> None:
    """Write a drive of six scans."""
    points = np.random.default_rng(1).normal(scale=9.0, size=(4000, 3)).astype("<f4")
    folder.mkdir()
    for index in range(6):
        (folder / f"{index}.bin").write_bytes(np.pad(points + index, ((0, 0), (0, 1))).tobytes())


def assert_licensed(wheel: Path) -> None:
    with ZipFile(wheel) as file:
        [licence] = [name for name in file.namelist() if name.endswith("licenses/LICENSE")]
        assert file.read(licence) == (ROOT / "LICENSE").read_bytes()


def test_the_wheel_holds_the_packages_the_migrations_and_the_licence(installed: Installed) -> None:
    with ZipFile(installed.wheel) as file:
        names = set(file.namelist())
    expected = {
        str(path.relative_to(ROOT))
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert any("migrations/versions/" in name for name in expected)
    assert expected <= names
    rest = names - expected
    assert {name.partition("/")[0] for name in rest} == {"tensormap_server-0.1.0.dist-info"}
    assert_licensed(installed.wheel)


def test_the_clients_wheel_is_pure_and_typed_and_has_the_licence(installed: Installed) -> None:
    assert installed.client.name.endswith("-py3-none-any.whl")
    with ZipFile(installed.client) as file:
        names = set(file.namelist())
    package = ROOT / "clients/python/tensormap_client"
    expected = {str(path.relative_to(package.parent)) for path in package.rglob("*.py")}
    assert expected | {"tensormap_client/py.typed"} <= names
    rest = {name.partition("/")[0] for name in names} - {"tensormap_client"}
    assert rest == {"tensormap_client-0.1.0.dist-info"}
    assert_licensed(installed.client)


def test_the_client_alone_localizes_with_three_libraries(
    installed: Installed, tmp_path: Path
) -> None:
    needed = tmp_path / "needed"
    needed.mkdir()
    names = link_needed("tensormap-client", needed)
    assert {"numpy", "httpx2", "websockets"} <= names
    assert not names & {"scipy", "h5py", "pydantic", "fastapi", "tensormap-server"}
    write_scans(tmp_path / "scans")
    code = """
import sys
from tensormap_client import Mapper, Vehicle
url = sys.argv[1]
with Mapper(url, None, "campus") as mapper:
    mapper.create_map()
    print(mapper.upload("scans", "monday").stored)
    mapper.build({"segments": 1})
import numpy
scan = numpy.fromfile("scans/3.bin", "<f4").reshape(-1, 4)
with Vehicle(url, None, "campus") as vehicle:
    print(vehicle.locate(scan).best.scan_index)
    track = vehicle.track()
    print(track.observe(scan).scan_index)
    track.close()
"""
    with serving(installed, tmp_path, "data") as url:
        shown = subprocess.run(
            [installed.folder / "vehicle/bin/python", "-W", "error", "-c", code, url],
            cwd=tmp_path,
            env={"PYTHONPATH": str(needed)},
            check=True,
            capture_output=True,
            text=True,
        ).stdout
    assert shown.split() == ["6", "3", "3"]


def test_what_is_imported_is_what_was_installed(installed: Installed, tmp_path: Path) -> None:
    code = "import app, core, storage; print(app.__file__, core.__file__, storage.__file__)"
    shown = subprocess.run(
        [installed.folder / "env/bin/python", "-c", code],
        cwd=tmp_path,
        env=installed.environment,
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    assert all(path.startswith(str(installed.folder)) for path in shown.split())


def test_the_installed_service_makes_its_catalog_in_an_empty_folder(
    installed: Installed, tmp_path: Path
) -> None:
    with serving(installed, tmp_path, "data") as url:
        assert httpx2.get(f"{url}/readyz").json() == {"ready": True, "missing": []}
        assert httpx2.post(f"{url}/v1/maps", json={"map": "campus"}).status_code == 201
        assert httpx2.get(f"{url}/docs").is_success
    assert (tmp_path / "data/catalog.sqlite3").exists()


def test_a_service_that_is_started_in_the_folder_of_another_project_builds_with_its_own_code(
    installed: Installed, tmp_path: Path
) -> None:
    for package in PACKAGES:
        (tmp_path / f"{package}.py").touch()
    write_scans(tmp_path / "scans")
    with serving(installed, tmp_path, "data") as url, Mapper(url, None, "campus") as mapper:
        mapper.create_map()
        mapper.upload(str(tmp_path / "scans"), "monday")
        assert mapper.build({"segments": 1})["revision"]


def test_the_installed_command_builds_and_inspects(installed: Installed, tmp_path: Path) -> None:
    def run(*arguments: str) -> str:
        return subprocess.run(
            [installed.command, *arguments],
            cwd=tmp_path,
            env=installed.environment,
            check=True,
            capture_output=True,
            text=True,
        ).stdout

    run("simulate", "town", "--scans", "10")
    run("build", "town", "-o", "town.h5")
    assert "revision" in run("inspect", "town.h5")
