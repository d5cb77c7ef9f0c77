"""Commands read scan files of all formats."""

import json

import numpy as np
import pytest

from core.scans.scan import Scan
from storage.formats.errors import UnknownFormat
from tests.support.captures import hdl32, pcap, udp
from tests.support.commands import run
from tests.support.recording import recording


def csv(scan: Scan) -> str:
    return "x,y,z\n" + "".join(f"{x!r},{y!r},{z!r}\n" for x, y, z in scan.points_m.tolist())


def nclt(scan: Scan) -> bytes:
    """Return a scan as NCLT has it: on the vehicle, y right, z down."""
    records = np.zeros(len(scan), [("xyz", "<u2", 3), ("intensity", "u1"), ("laser", "u1")])
    on_vehicle_m = scan.points_m * [1, -1, -1] + [0.002, -0.004, -0.957]
    records["xyz"] = np.rint((on_vehicle_m + 100.0) / 0.005)
    return records.tobytes()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A drive of CSV files."""
    folder = tmp_path_factory.mktemp("formats") / "monday"
    folder.mkdir()
    for index, scan in enumerate(recording(scans=8).scans):
        (folder / f"{index}.csv").write_text(csv(scan))
    return folder


def test_a_folder_of_text_is_built_and_a_scan_in_other_records_localized(folder, tmp_path):
    out = tmp_path / "map.h5"
    run("build", folder, "-o", out, "--segments", "1")
    within = recording(scans=8).scans[5].points_m
    within = within[(np.abs(within) < 90).all(axis=1)]
    (tmp_path / "5.bin").write_bytes(nclt(Scan(within)))
    answer = json.loads(run("localize", out, tmp_path / "5.bin", "--format", "nclt", "--json"))
    assert answer["best"]["scan_index"] == 5
    signed = json.loads(run("signature", out, tmp_path / "5.bin", "--format", "nclt"))
    assert len(signed["signatures"]) == 1
    with pytest.raises(UnknownFormat, match="there is no format 'ncl'; wanted one of kitti"):
        run("localize", out, tmp_path / "5.bin", "--format", "ncl")


def test_a_capture_is_built_with_one_scan_per_revolution(tmp_path):
    frames = [frame for payload in hdl32(turns=3.2) for frame in udp(payload, 2368)]
    (tmp_path / "monday.pcap").write_bytes(pcap(frames))
    run("build", tmp_path / "monday.pcap", "-o", tmp_path / "map.h5", "--segments", "1")
    facts = json.loads(run("inspect", tmp_path / "map.h5", "--json"))
    assert (facts["scans"], facts["drives"]) == (3, ["monday"])


def test_a_drive_of_nclt_has_the_times_that_its_files_are_named_by(tmp_path):
    (tmp_path / "2012-01-08/velodyne_sync").mkdir(parents=True)
    for index, scan in enumerate(recording(scans=2).scans):
        within = scan.points_m[(np.abs(scan.points_m) < 90).all(axis=1)]
        name = f"{1326652795280148 + 200_000 * index}.bin"
        (tmp_path / "2012-01-08/velodyne_sync" / name).write_bytes(nclt(Scan(within)))
    run("build", tmp_path / "2012-01-08", "-o", tmp_path / "map.h5", "--segments", "1")
    facts = json.loads(run("inspect", tmp_path / "map.h5", "--json"))
    assert facts["scans"] == 2
