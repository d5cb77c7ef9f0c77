"""What every scan format promises, whatever the bytes."""

import struct
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pypcd4.pypcd4 import Encoding

from core.errors import TensorMapError
from core.scans.scan import Scan
from storage.formats.scans.records import NuscenesFormat
from storage.formats.scans.registry import SCAN_FORMATS, read_scan
from tests.support.scan_files import csv, ford, kitti, las, npy, nuscenes, pcd, ply, ply_ascii

COORDINATES = st.floats(0.125, 200.0, width=32) | st.floats(-200.0, -0.125, width=32)
CLOUDS = arrays(np.float32, st.tuples(st.integers(1, 40), st.just(3)), elements=COORDINATES)


WRITERS = {
    "kitti": (SCAN_FORMATS[0].media_type, kitti),
    "npy": (None, npy),
    "npy doubles": (None, lambda points: npy(points.astype(np.float64))),
    "npy columns": (None, lambda points: npy(np.asfortranarray(points))),
    "nuscenes": (NuscenesFormat().media_type, nuscenes),
    "ply ascii": (None, ply_ascii),
    "ply binary": (None, lambda points: ply(points, "<")),
    "ply binary, big end first": (None, lambda points: ply(points, ">")),
    "csv": (None, csv),
    "ford": (None, lambda points: ford(points, compress=False)),
    "ford compressed": (None, lambda points: ford(points, compress=True)),
    "las": (None, las),
    "pcd ascii": (None, lambda points: pcd(points, Encoding.ASCII)),
    "pcd binary": (None, lambda points: pcd(points, Encoding.BINARY)),
    "pcd compressed": (None, lambda points: pcd(points, Encoding.BINARY_COMPRESSED)),
}
# Real files, to be damaged: random bytes alone seldom pass a magic.
WHOLE = [
    (media_type, write(np.linspace(1, 60, 60, dtype=np.float32).reshape(-1, 3)))
    for media_type, write in WRITERS.values()
]
TYPES = st.sampled_from([None, *(known.media_type for known in SCAN_FORMATS)])
NPY_HEADERS = st.one_of(
    st.text("{}[](),:' 0123456789<>|=fiuabcSUVTrueFlsdhp_o.\\-L\n", max_size=80),
    st.builds(
        "{{'descr': {}, 'fortran_order': {}, 'shape': {}, }}\n".format,
        st.sampled_from(["'<f4'", "'a4'", "'|O'", "[('x', '<f4')]", "[('x', '<f4', (9,))]", "3"]),
        st.sampled_from(["True", "False", "1", "()"]),
        st.lists(st.integers(-1, 10**30), max_size=3).map(tuple),
    ),
)
PCD_WORDS = st.sampled_from(
    ["x", "y", "z", "_", "4", "8", "1", "F", "U", "I", "7", "99999999", "-"]
)
PCD_KEYS = ["VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS"]
PCD_HEADERS = st.lists(
    st.tuples(
        st.sampled_from(PCD_KEYS),
        st.lists(PCD_WORDS, max_size=4).map(" ".join),
    ),
    max_size=9,
).map(lambda lines: "".join(f"{key} {words}\n" for key, words in lines))


def gives_a_scan_or_an_error_of_ours(body: bytes, media_type: str | None) -> None:
    with suppress(TensorMapError):
        assert isinstance(read_scan(body, media_type=media_type, min_returns=1), Scan)


@pytest.mark.parametrize("kind", WRITERS)
@settings(max_examples=30)
@given(points=CLOUDS)
def test_what_is_written_is_read(kind: str, points: np.ndarray) -> None:
    media_type, write = WRITERS[kind]
    scan = read_scan(write(points), media_type=media_type, min_returns=1)
    # Its writer prints ten digits after the point; LAS counts steps, here of 0.1 mm.
    atol = {"pcd ascii": 1e-6, "las": 1e-4}.get(kind, 0)
    np.testing.assert_allclose(scan.points_m, points, rtol=0, atol=atol)


@given(body=st.binary(max_size=400), media_type=TYPES)
def test_any_bytes_give_a_scan_or_an_error_of_ours(body: bytes, media_type: str | None) -> None:
    gives_a_scan_or_an_error_of_ours(body, media_type)


@settings(max_examples=300)
@given(data=st.data())
def test_damaged_files_give_a_scan_or_an_error_of_ours(data: st.DataObject) -> None:
    media_type, whole = data.draw(st.sampled_from(WHOLE))
    start = data.draw(st.integers(0, len(whole)))
    length = data.draw(st.integers(0, 8))
    body = whole[:start] + data.draw(st.binary(max_size=8)) + whole[start + length :]
    gives_a_scan_or_an_error_of_ours(body, media_type)


@settings(max_examples=300)
@given(header=NPY_HEADERS, version=st.integers(0, 4), points=st.binary(max_size=48))
def test_any_npy_header_gives_a_scan_or_an_error_of_ours(
    header: str, version: int, points: bytes
) -> None:
    length = struct.pack("<H" if version < 2 else "<I", len(header))
    body = b"\x93NUMPY" + bytes([version, 0]) + length + header.encode() + points
    gives_a_scan_or_an_error_of_ours(body, None)


@settings(max_examples=300)
@given(
    header=PCD_HEADERS,
    encoding=st.sampled_from(["ascii", "binary", "binary_compressed"]),
    points=st.binary(max_size=48),
)
def test_any_pcd_header_gives_a_scan_or_an_error_of_ours(
    header: str, encoding: str, points: bytes
) -> None:
    body = f"# .PCD\n{header}DATA {encoding}\n".encode() + points
    gives_a_scan_or_an_error_of_ours(body, None)


FLOATS = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH {}\nHEIGHT 1\nDATA {}\n"


@settings(max_examples=300)
@given(packed=st.binary(max_size=60), points=st.integers(0, 400))
def test_any_compressed_points_give_a_scan_or_an_error_of_ours(packed: bytes, points: int) -> None:
    sizes = struct.pack("<II", len(packed), points * 12)
    body = FLOATS.format(points, "binary_compressed").encode() + sizes + packed
    gives_a_scan_or_an_error_of_ours(body, None)


@settings(max_examples=300)
@given(values=st.text("0123456789.-+eEnainf \t\r\n\x0b_,jx", max_size=60), points=st.integers(0, 3))
def test_any_text_points_give_a_scan_or_an_error_of_ours(values: str, points: int) -> None:
    body = FLOATS.format(points, "ascii").encode() + values.encode()
    gives_a_scan_or_an_error_of_ours(body, None)
