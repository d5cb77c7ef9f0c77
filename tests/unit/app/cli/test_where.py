"""`tensormap where`."""

import json

import pytest

from app.cli import queries
from core.errors import InvalidParameters
from core.projection.imager import Imager
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


@pytest.fixture
def counted(monkeypatch):
    """The names of the scan files that are read, and the sensor heights of images that are made."""
    read, projected = [], []
    read_scan, image = queries._read, Imager.image

    def reading(path, *of_format):
        read.append(path.name)
        return read_scan(path, *of_format)

    def projecting(imager, *of_scan):
        projected.append(imager.sensor_height_m)
        return image(imager, *of_scan)

    monkeypatch.setattr(queries, "_read", reading)
    monkeypatch.setattr(Imager, "image", projecting)
    return read, projected


@pytest.fixture(scope="module")
def maps(district):
    """The maps of both districts, and one of the north's scans as of a lower sensor."""
    low = district / "low.h5"
    options = ["--lateral-renderings=0", "--segments", "2", "--sensor-height-m", "1.5"]
    run("build", district / "north", "-o", low, *options)
    files = (district / "north.h5", district / "south.h5", low)
    return [word for path in files for word in ("--map", path)]


def test_a_scan_is_read_once_and_projected_once_for_maps_of_one_imager(
    district, maps, counted
) -> None:
    names = ["000003.bin", "000007.bin"]
    run("where", *(district / "north" / name for name in names), *maps)
    assert counted == (names, [1.73, 1.5] * 2)


def test_a_mounted_scan_is_read_for_each_sensor_height(district, maps, counted) -> None:
    scan = district / "north" / "000003.bin"
    run("where", scan, *maps, "--mounting", "0,0,1.73")
    assert counted == (["000003.bin"] * 2, [1.73, 1.5])


@pytest.mark.parametrize(
    "options",
    [
        ["--sensor-height-m", "9"],
        ["--roll-deg=3", "--pitch-deg=-5"],
        ["--mounting", "0,0,1.9,0,2,0", "--roll-deg=0", "--pitch-deg=-2"],
    ],
)
def test_a_scan_of_another_height_or_tilt_is_the_same_query_as_in_one_map(
    district, options
) -> None:
    scan, map_file = district / "north" / "000007.bin", district / "north.h5"
    plain = json.loads(run("where", scan, "--map", map_file, "--json"))
    found = json.loads(run("where", scan, "--map", map_file, "--json", *options))
    localized = json.loads(run("localize", map_file, scan, "--json", *options))
    assert found["best"]["distance"] == localized["best"]["distance"]
    assert found["best"]["distance"] != plain["best"]["distance"]


@pytest.mark.parametrize(
    "options", [["--mounting", "0,0,1.9", "--sensor-height-m", "1.9"], ["--roll-deg=3"]]
)
def test_two_heights_or_half_a_tilt_are_rejected(district, maps, options) -> None:
    with pytest.raises(InvalidParameters):
        run("where", district / "north" / "000003.bin", *maps, *options)


def test_two_maps_of_one_name_are_refused(district):
    twice = ["--map", district / "north.h5", "--map", district / "north.h5"]
    with pytest.raises(InvalidParameters, match="north"):
        run("where", district / "north" / "000000.bin", *twice)
