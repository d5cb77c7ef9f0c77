"""PCD: three encodings, padding, organized clouds, and headers that lie."""

import struct
import tracemalloc
from io import BytesIO

import numpy as np
import pytest
from pypcd4.pypcd4 import Encoding, PointCloud

from storage.formats.budget import Budget
from storage.formats.errors import MalformedScan, ScanTooLarge, TruncatedScan, WrongDtype
from storage.formats.scans import pcd
from storage.formats.scans.pcd import PcdFormat

POINTS = np.random.default_rng(2).normal(0, 20, (200, 3)).astype(np.float32)


def header(**changes: str | None) -> bytes:
    usual: dict[str, str | None] = {
        "VERSION": "0.7",
        "FIELDS": "x y z",
        "SIZE": "4 4 4",
        "TYPE": "F F F",
        "COUNT": "1 1 1",
        "WIDTH": "200",
        "HEIGHT": "1",
        "VIEWPOINT": "0 0 0 1 0 0 0",
        "POINTS": "200",
        "DATA": "binary",
    }
    text = "".join(
        f"{key} {value}\n" for key, value in (usual | changes).items() if value is not None
    )
    return b"# .PCD v0.7 - Point Cloud Data file format\n" + text.encode()


def read(body: bytes) -> np.ndarray:
    return PcdFormat().read(body)


@pytest.mark.parametrize("encoding", list(Encoding)[:3])
def test_the_points_of_every_encoding_are_the_same(encoding: Encoding) -> None:
    file = BytesIO()
    PointCloud.from_xyzi_points(np.column_stack([POINTS, POINTS[:, 0]])).save(file, encoding)
    np.testing.assert_allclose(read(file.getvalue()), POINTS, rtol=0, atol=1e-6)


@pytest.mark.parametrize("encoding", ["binary", "binary_compressed"])
def test_padding_and_fields_of_many_columns_are_skipped(encoding: str) -> None:
    dtype = np.dtype(
        [("pad", "u1", 4), ("z", "<f8"), ("y", "<f4"), ("x", "<f4"), ("i", "<f4"), ("p", "u1", 10)]
    )
    cloud = np.zeros(200, dtype)
    cloud["x"], cloud["y"], cloud["z"] = POINTS.T
    cloud["pad"] = 255
    fields = {
        "FIELDS": "_ z y x intensity[0] _",
        "SIZE": "1 8 4 4 4 1",
        "TYPE": "U F F F F U",
        "COUNT": "4 1 1 1 1 10",
    }
    body = cloud.tobytes()
    if encoding == "binary_compressed":
        columns = b"".join(cloud[name].tobytes() for name in dtype.names or ())
        body = lzf_literal(columns)
    np.testing.assert_array_equal(read(header(DATA=encoding, **fields) + body), POINTS)


def lzf_literal(data: bytes) -> bytes:
    """Pack bytes as LZF literals, at most 32 a run."""
    runs = [data[at : at + 32] for at in range(0, len(data), 32)]
    packed = b"".join(bytes([len(run) - 1]) + run for run in runs)
    return struct.pack("<II", len(packed), len(data)) + packed


def test_the_nan_points_of_an_organized_cloud_are_kept_for_counting() -> None:
    organized = POINTS.copy()
    organized[::3] = np.nan
    read_back = read(header(WIDTH="20", HEIGHT="10") + organized.tobytes())
    np.testing.assert_array_equal(read_back, organized)


def test_text_may_hold_tabs_trailing_spaces_windows_line_ends_and_integers() -> None:
    text = b"1.5\t-2  3 7.0 \r\n\r\nnan nan nan 8\r\n"
    lines = {"FIELDS": "x y z ring", "SIZE": "4 4 4 2", "TYPE": "F F F U", "COUNT": "1 1 1 1"}
    body = header(**lines, WIDTH="2", POINTS="2", DATA="ascii").replace(b"\n", b"\r\n") + text
    np.testing.assert_array_equal(read(body), [[1.5, -2, 3], [np.nan] * 3])


def test_optional_lines_of_the_header_may_be_missing() -> None:
    body = header(VERSION=None, COUNT=None, VIEWPOINT=None, POINTS=None) + POINTS.tobytes()
    np.testing.assert_array_equal(read(body), POINTS)


def test_a_cloud_of_no_points_is_empty() -> None:
    for encoding in ("ascii", "binary", "binary_compressed"):
        assert read(header(WIDTH="0", POINTS="0", DATA=encoding)).shape == (0, 3)


@pytest.mark.parametrize(
    ("lines", "body"),
    [
        ({"POINTS": "1000000000000", "WIDTH": "1000000000000"}, b"\0" * 2400),
        ({"POINTS": "1000000000000", "WIDTH": None, "DATA": "ascii"}, b"1 2 3\n" * 9),
        (
            {"POINTS": "40000000", "WIDTH": "40000000", "DATA": "binary_compressed"},
            struct.pack("<II", 20, 480_000_000) + b"\0" * 20,
        ),
        (
            {"POINTS": "4000000", "WIDTH": "4000000", "DATA": "binary_compressed"},
            struct.pack("<II", 20, 48_000_000) + b"\0" * 20,
        ),
    ],
)
def test_a_header_that_claims_more_than_the_body_is_rejected_without_allocation(
    lines: dict[str, str | None], body: bytes
) -> None:
    tracemalloc.start()
    try:
        with pytest.raises(TruncatedScan):
            read(header(**lines) + body)
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


def test_a_compressed_body_may_not_unpack_to_more_than_allowed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(pcd, "BUDGET", Budget(decoded_bytes=1000))
    file = BytesIO()
    PointCloud.from_xyz_points(np.ones((200, 3), np.float32)).save(file, Encoding.BINARY_COMPRESSED)
    with pytest.raises(ScanTooLarge, match="at most 1000 bytes"):
        PcdFormat().read(file.getvalue())


@pytest.mark.parametrize(
    "lines",
    [
        {"COUNT": "1 1 100000000"},
        {"FIELDS": "x y z _", "SIZE": "4 4 4 1", "TYPE": "F F F U", "COUNT": "1 1 1 100000000"},
        {"COUNT": "0 1 1"},
        {"SIZE": "4 4"},
        {"SIZE": "4 4 3"},
        {"TYPE": "F F X"},
        {"FIELDS": "x y y"},
        {"FIELDS": "x y i"},
        {"FIELDS": None},
        {"WIDTH": "100"},
        {"POINTS": "-200"},
        {"POINTS": "2e2"},
        {"POINTS": "1 2"},
        {"POINTS": "9" * 5000},
        {"POINTS": None, "WIDTH": None},
        {"DATA": "binaryscompressed"},
        {"DATA": None},
    ],
)
def test_a_header_that_makes_no_sense_is_malformed(lines: dict[str, str | None]) -> None:
    with pytest.raises(MalformedScan):
        read(header(**lines) + POINTS.tobytes())


def test_integer_axes_are_of_the_wrong_type() -> None:
    with pytest.raises(WrongDtype, match="field x has TYPE I"):
        read(header(TYPE="I F F") + POINTS.tobytes())


def test_the_error_for_fewer_or_more_bytes_than_the_header_claims_has_both_numbers() -> None:
    with pytest.raises(TruncatedScan, match=r"2400 bytes; got 2390 bytes of points"):
        read(header() + POINTS.tobytes()[:-10])
    with pytest.raises(MalformedScan, match=r"2400 bytes; got 2401 bytes of points"):
        read(header() + POINTS.tobytes() + b"!")
    with pytest.raises(TruncatedScan, match="200 points of 12 bytes"):
        read(header(DATA="ascii") + b"1 2 3\n" * 199 + b"\n" * 400)


@pytest.mark.parametrize("encoding", ["binary", "binary_compressed"])
def test_zeros_after_the_points_are_the_filling_of_a_page(encoding: str) -> None:
    points = POINTS.copy()
    points[-1] = 0.0
    body = points.tobytes() if encoding == "binary" else lzf_literal(points.T.tobytes())
    body = header(DATA=encoding) + body
    np.testing.assert_array_equal(read(body + bytes(3880)), points)
    with pytest.raises(MalformedScan, match="bytes of points"):
        read(body + bytes(3880) + b"!")


def test_damaged_compressed_or_text_points_are_malformed() -> None:
    file = BytesIO()
    PointCloud.from_xyz_points(np.ones((200, 3), np.float32)).save(file, Encoding.BINARY_COMPRESSED)
    whole = file.getvalue()
    with pytest.raises(MalformedScan):
        read(whole[:-4] + b"\xff\xff\xff\xff")
    with pytest.raises(MalformedScan, match=r"^line 14: a coordinate is no number: .*three"):
        read(header(DATA="ascii") + b"1 2 3\n1 2 3\n" + b"1 2 three\n" * 198)
    with pytest.raises(MalformedScan, match="'#'"):
        read(header(DATA="ascii") + b"1 2 3 # four\n" * 200)


@pytest.mark.parametrize(
    "body", [b"\xd7c?\x00\n" * 9, b"ply\nformat ascii 1.0\n", POINTS.tobytes()]
)
def test_another_format_is_called_no_pcd(body: bytes) -> None:
    with pytest.raises(MalformedScan, match=r"no PCD file: .* wanted a header that begins with"):
        read(body)
