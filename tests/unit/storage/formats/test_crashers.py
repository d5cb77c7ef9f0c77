"""Inputs that once ended in another error than one of ours: found by tests/torture."""

from pathlib import Path

import pytest

from app.drives.pose_files import CSV, read_poses
from core.errors import InvalidMap, InvalidPose
from core.mapping.tensormap import TensorMap
from storage.formats.drives.layouts import open_drive
from storage.formats.errors import EmptyBody
from storage.formats.scans.delimited import CsvFormat
from tests.support.samples import sample_map


def test_a_capture_without_a_byte_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.pcap").touch()
    with pytest.raises(EmptyBody, match=r"a\.pcap is empty"):
        open_drive(tmp_path / "a.pcap")


@pytest.mark.parametrize("lines", [b"", b"\n", b" \n\n"])
def test_a_table_without_a_line_is_refused(lines: bytes) -> None:
    with pytest.raises(InvalidPose, match="no line with a pose"):
        read_poses(b"scan,x,y,z,qx,qy,qz,qw\n" + lines, CSV)
    assert CsvFormat().read(b"x,y,z\n" + lines).shape == (0, 3)


@pytest.mark.parametrize(
    ("name", "dtype"),
    [("signatures", "c16"), ("pose", "c16"), ("scan_index", "f8"), ("segment_start", "U8")],
)
def test_parts_of_another_kind_are_no_map(name: str, dtype: str) -> None:
    made = sample_map(count=6, segment_length=3)[0]
    arrays = made.arrays() | {name: made.arrays()[name].astype(dtype)}
    with pytest.raises(InvalidMap, match=f"{name} holds"):
        TensorMap.from_parts(arrays, made.attributes())
