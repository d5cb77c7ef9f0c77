"""What `tensormap evaluate` prints, in process."""

import json

import pytest

from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from storage.formats.drives.kitti_drive import write_kitti_drive
from tests.support.commands import run

pytestmark = pytest.mark.slow


def test_queries_that_cannot_be_used_are_counted_beside_all_of_them(tmp_path) -> None:
    drive = SimulatedDrive(seed=1, scans=12, stops=False, sensor=SimulatedSensor(firings=180))
    write_kitti_drive(drive, tmp_path / "monday")
    (tmp_path / "monday/velodyne/000003.bin").write_bytes(bytes(17))
    out = tmp_path / "figures.json"
    options = ("--split", "every:2", "--yaw-deg", "0,90", "--lateral-renderings=0", "--json", out)
    shown = run("evaluate", tmp_path / "monday", *options)
    rows = json.loads(out.read_text())["conditions"]
    assert [(row["queries"], row["refusals"]) for row in rows] == [(6, 1), (6, 1)]
    assert "; map : images : returns = 1 : " in shown
    assert "unusable: 2 of 12 queries, in no figure but their number\n" in shown
