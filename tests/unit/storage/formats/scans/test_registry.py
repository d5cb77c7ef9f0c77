"""Which reader a body gets."""

import math
from pathlib import Path

import numpy as np
import pytest

from core.errors import TooFewReturns
from core.scans.pose import Pose
from storage.formats.errors import EmptyBody, MalformedScan, TruncatedScan, UnknownFormat
from storage.formats.scans.registry import SCAN_FORMATS, read_scan, read_scan_file

ROWS = np.array([[10.0, 1.0, -1.0, 0.5], [0.0, 0.0, 0.0, 0.5]], "<f4")
PCD = (
    b"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1\nHEIGHT 1\n"
    b"POINTS 1\nDATA ascii\n10 1 -1\n"
)


def test_parameters_and_case_of_a_content_type_do_not_matter() -> None:
    scan = read_scan(
        ROWS.tobytes(),
        media_type="Application/VND.tensormap.KITTI ; Charset=binary",
        min_returns=1,
        timestamp_s=12.5,
        pose=Pose(1.0, 2.0, 3.0),
    )
    assert (len(scan), scan.dropped_returns, scan.timestamp_s) == (1, 1, 12.5)
    assert scan.pose == Pose(1.0, 2.0, 3.0)


@pytest.mark.parametrize("media_type", [None, "", "application/octet-stream"])
def test_without_a_type_the_magic_decides(media_type: str | None) -> None:
    scan = read_scan(PCD, media_type=media_type, min_returns=1)
    np.testing.assert_array_equal(scan.points_m, [[10.0, 1.0, -1.0]])


@pytest.mark.parametrize(
    "given",
    [{}, {"media_type": "text/csv"}, {"suffix": ".xyz"}, {"suffix": ".pcapng"}],
)
def test_the_error_for_an_unknown_format_lists_all_media_types(given: dict[str, str]) -> None:
    with pytest.raises(UnknownFormat) as caught:
        read_scan(
            ROWS.tobytes(),
            media_type=given.get("media_type"),
            suffix=given.get("suffix"),
            min_returns=1,
        )
    assert all(known.media_type in str(caught.value) for known in SCAN_FORMATS)


def test_a_media_type_wins_over_the_magic() -> None:
    with pytest.raises(MalformedScan, match=r"\.npy"):
        read_scan(PCD, media_type="application/vnd.tensormap.npy", min_returns=1)


@pytest.mark.parametrize("media_type", [None, *(known.media_type for known in SCAN_FORMATS)])
def test_no_bytes_are_an_empty_body(media_type: str | None) -> None:
    with pytest.raises(EmptyBody):
        read_scan(b"", media_type=media_type, min_returns=1)


def test_fewer_returns_than_min_returns_are_rejected() -> None:
    with pytest.raises(TooFewReturns, match="1 of 2"):
        read_scan(ROWS.tobytes(), suffix=".bin", min_returns=2)


def test_a_file_is_read_by_its_suffix_and_errors_name_it(tmp_path: Path) -> None:
    (tmp_path / "7.BIN").write_bytes(ROWS.tobytes())
    (tmp_path / "8.bin").write_bytes(ROWS.tobytes()[:-1])
    scan = read_scan_file(tmp_path / "7.BIN", min_returns=1)
    assert len(scan) == 1
    assert math.isnan(scan.timestamp_s)
    with pytest.raises(TruncatedScan, match=r"^8\.bin: "):
        read_scan_file(tmp_path / "8.bin", min_returns=1)


def test_a_nuscenes_file_is_not_taken_for_kitti(tmp_path: Path) -> None:
    rows = np.array([[10.0, 1.0, -1.0, 7.0, ring] for ring in range(4)], "<f4")
    (tmp_path / "LIDAR_TOP.pcd.bin").write_bytes(rows.tobytes())
    scan = read_scan_file(tmp_path / "LIDAR_TOP.pcd.bin", min_returns=1)
    np.testing.assert_array_equal(scan.points_m, rows[:, :3])


def test_records_without_a_header_are_never_guessed() -> None:
    nuscenes = np.array([[10.0, 1.0, -1.0, 7.0, 3.0]] * 4, "<f4").tobytes()
    for body in (ROWS.tobytes(), nuscenes):
        with pytest.raises(UnknownFormat, match="set the Content-Type"):
            read_scan(body, min_returns=1)


def test_a_signalling_nan_is_a_no_return_like_any_other() -> None:
    bits = np.array([[0x7FA00001] * 4, [0x3F800000] * 4], "<u4")
    scan = read_scan(bits.tobytes(), suffix=".bin", min_returns=1)
    assert (len(scan), scan.dropped_returns) == (1, 1)


def test_names_media_types_and_suffixes_are_unique() -> None:
    for words in (
        [known.name for known in SCAN_FORMATS],
        [known.media_type for known in SCAN_FORMATS],
        [suffix for known in SCAN_FORMATS for suffix in known.suffixes],
    ):
        assert len(set(words)) == len(words)
        assert all(word == word.lower() for word in words if "/" in word or word[0] == ".")
