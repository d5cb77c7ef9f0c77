"""Generated folders in MulRan's layout."""

from pathlib import Path

import numpy as np
import pytest

from core.errors import EmptyDrive
from storage.formats.drives.layouts import open_drive
from storage.formats.errors import MalformedDrive

FIRST_NS = 1561000444390857630
STEP_NS = 100_000_000


def mulran(folder: Path, scans: str = "sensor_data/Ouster", count: int = 3) -> Path:
    (folder / scans).mkdir(parents=True)
    for index in range(count):
        row = np.array([[10.0 + index, 1.0, -1.0, 0.5]], "<f4")
        (folder / scans / f"{FIRST_NS + index * STEP_NS}.bin").write_bytes(row.tobytes())
    return folder


def line(at_ns: int, x_m: float, rotation: str = "1 0 0 0 1 0 0 0 1") -> str:
    r = rotation.split()
    cells = [*r[:3], str(x_m), *r[3:6], "4000000.0", *r[6:], "20.0"]
    return f"{at_ns}," + ",".join(cells) + "\n"


@pytest.mark.parametrize("scans", ["sensor_data/Ouster", "Ouster"])
def test_scans_have_the_times_of_their_names_and_without_a_file_no_poses(
    tmp_path: Path, scans: str
) -> None:
    drive = open_drive(mulran(tmp_path / "DCC01", scans))
    assert (drive.name, len(drive)) == ("DCC01", 3)
    np.testing.assert_allclose(np.diff(drive.timestamp_s), 0.1, atol=1e-6)
    assert drive.scan(2).points_m.tolist() == [[12.0, 1.0, -1.0]]
    assert np.isnan(drive.poses).all()


def test_poses_are_the_ousters_between_those_of_the_file(tmp_path: Path) -> None:
    folder = mulran(tmp_path / "DCC01")
    times = [FIRST_NS - STEP_NS // 2 + index * STEP_NS for index in range(3)]
    (folder / "global_pose.csv").write_text(
        "".join(line(at, 350_000.0 + 10.0 * index) for index, at in enumerate(times))
    )
    drive = open_drive(folder)
    # Half-way between poses 10 m apart; the sensor 1.7042 m ahead, 0.021 m right, 1.8047 m up.
    np.testing.assert_allclose(
        drive.poses[:2, :3],
        [[350_006.7042, 3_999_999.979, 21.8047], [350_016.7042, 3_999_999.979, 21.8047]],
        atol=1e-3,  # nanoseconds since 1970 in doubles
    )
    pose = drive.scan(0).pose
    assert pose is not None
    assert pose.yaw_deg == pytest.approx(179.6654, abs=1e-4)  # the sensor looks back
    assert np.isnan(drive.poses[2]).all()  # after the last pose


def test_a_vehicle_that_turns_takes_the_sensor_with_it(tmp_path: Path) -> None:
    folder = mulran(tmp_path / "DCC01", count=1)
    (folder / "global_pose.csv").write_text(line(FIRST_NS, 0.0, "0 -1 0 1 0 0 0 0 1"))
    [pose] = open_drive(folder / "sensor_data").poses  # the same drive
    assert open_drive(folder / "sensor_data").name == "DCC01"
    np.testing.assert_allclose(pose[:3], [0.021, 4_000_001.7042, 21.8047], atol=1e-6)


def test_a_wrong_folder_says_what_was_wanted_and_what_came(tmp_path: Path) -> None:
    empty = mulran(tmp_path / "empty", count=0)
    with pytest.raises(EmptyDrive, match=r"sensor_data/Ouster has no scan files \*\.bin"):
        open_drive(empty)
    named = mulran(tmp_path / "named")
    (named / "sensor_data/Ouster/first.bin").write_bytes(bytes(16))
    with pytest.raises(
        MalformedDrive, match=r"first\.bin is not named by its time, wanted nanosec"
    ):
        open_drive(named)
    other = mulran(tmp_path / "other")
    (other / "global_pose.csv").write_text(line(FIRST_NS - 10**12, 0.0))
    with pytest.raises(MalformedDrive, match=r"global_pose\.csv has poses from .*the scans are"):
        open_drive(other)
    tum = mulran(tmp_path / "tum")
    (tum / "global_pose.csv").write_text("1,2,3\n")
    with pytest.raises(MalformedDrive, match=r"global_pose\.csv, line 1: 3 values, wanted 13"):
        open_drive(tum)
