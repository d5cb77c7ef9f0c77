"""`tensormap where`."""

import json

import pytest

from app.cli import queries
from core.errors import InvalidParameters
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from tests.support.commands import run
from tests.support.recording import kitti

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def district(tmp_path_factory):
    """Two districts: folders of their scans, and a map of each with one basis."""
    folder = tmp_path_factory.mktemp("districts")
    options = ["--lateral-renderings=-1.5,0,1.5", "--segments", "2"]
    for name, seed in (("north", 31), ("south", 32)):
        (folder / name).mkdir()
        drive = SimulatedDrive(
            seed=seed, scans=12, stops=False, sensor=SimulatedSensor(firings=180)
        )
        for index, scan in enumerate(drive):
            (folder / name / f"{index:06}.bin").write_bytes(kitti(scan))
        run("build", folder / name, "-o", folder / f"{name}.h5", *options)
        options += ["--keep-basis", str(folder / "north.h5")] if name == "north" else []
    return folder


def test_where_names_the_map(district):
    maps = ["--map", district / "north.h5", "--map", district / "south.h5"]
    for name in ("north", "south"):
        answer = json.loads(run("where", district / name / "000007.bin", *maps, "--json"))
        assert (answer["map"], answer["best"]["scan_index"]) == (name, 7)
        assert answer["maps_searched"] == 2
        assert name in run("where", district / name / "000007.bin", *maps)


def test_a_scan_is_read_once_for_all_maps_of_one_sensor_height(district, monkeypatch):
    read, read_scan = [], queries._read

    def counted(path, *of_format):
        read.append(path.name)
        return read_scan(path, *of_format)

    monkeypatch.setattr(queries, "_read", counted)
    maps = ["--map", district / "north.h5", "--map", district / "south.h5"]
    scans = [district / "north" / name for name in ("000003.bin", "000007.bin")]
    run("where", *scans, *maps)
    assert read == ["000003.bin", "000007.bin"]


def test_two_maps_of_one_name_are_refused(district):
    twice = ["--map", district / "north.h5", "--map", district / "north.h5"]
    with pytest.raises(InvalidParameters, match="north"):
        run("where", district / "north" / "000000.bin", *twice)
