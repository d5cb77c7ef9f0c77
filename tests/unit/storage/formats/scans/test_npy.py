"""NumPy's `.npy`: the header is a client's text."""

import time
import tracemalloc
from ast import literal_eval
from concurrent.futures import ThreadPoolExecutor
from io import BytesIO
from typing import Literal

import numpy as np
import pytest

from storage.formats.errors import MalformedScan, ScanTooLarge, TruncatedScan, WrongDtype
from storage.formats.scans.npy import NpyFormat
from storage.formats.scans.registry import read_scan

POINTS = np.array([[10.5, -2.25, 0.5], [np.nan, 0, 0], [-7, 3, -1.5]])


def npy(array: np.ndarray, *, allow_pickle: bool = False) -> bytes:
    file = BytesIO()
    np.save(file, array, allow_pickle=allow_pickle)
    return file.getvalue()


def with_header(header: str, body: bytes = b"") -> bytes:
    text = header.encode("latin-1")
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + body


@pytest.mark.parametrize("dtype", ["<f2", "<f4", "<f8", ">f4", ">f8"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_floats_of_every_size_and_order_give_the_same_points(
    dtype: str, order: Literal["C", "F"]
) -> None:
    wide = np.column_stack([POINTS, [0.1, 0.2, 0.3]]).astype(dtype, order=order)
    np.testing.assert_array_equal(NpyFormat().read(npy(wide)), POINTS.astype(np.float32))


def test_one_header_at_a_time_is_parsed(monkeypatch: pytest.MonkeyPatch) -> None:
    parsing: list[str] = []

    def slowly(text: str) -> object:
        assert not parsing, "python 3.11 cannot do this in two threads"
        parsing.append(text)
        time.sleep(0.01)
        return literal_eval(parsing.pop())

    monkeypatch.setattr("storage.formats.scans.npy.ast.literal_eval", slowly)
    bodies = [npy(POINTS)] * 8
    with ThreadPoolExecutor(len(bodies)) as threads:
        assert all(len(read) == len(POINTS) for read in threads.map(NpyFormat().read, bodies))


def test_of_a_structured_array_the_fields_x_y_z_are_read_in_that_order() -> None:
    cloud = np.zeros((1, 3), [("intensity", "u1"), ("z", "<f8"), ("y", "<f4"), ("x", "<f4")])
    cloud["x"], cloud["y"], cloud["z"] = POINTS.T
    np.testing.assert_array_equal(NpyFormat().read(npy(cloud)), POINTS.astype(np.float32))


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("columns", [3, 4])
def test_an_organised_array_has_its_returns_row_by_row(
    order: Literal["C", "F"], columns: int
) -> None:
    points = np.random.default_rng(0).normal(0, 9, (64, 128, columns)).astype(np.float32)
    returns_m = NpyFormat().read(npy(points.copy(order=order)))
    np.testing.assert_array_equal(returns_m, points.reshape(-1, columns)[:, :3])


def test_an_organised_array_may_have_no_return_and_not_more_than_a_scan() -> None:
    assert NpyFormat().read(npy(np.ones((0, 9, 3), np.float32))).shape == (0, 3)
    with pytest.raises(ScanTooLarge, match="4195328 returns, at most 4194304"):
        NpyFormat().read(npy(np.ones((4097, 1024, 3), np.float16)))


@pytest.mark.parametrize("shape", [(3, 64, 1024), (64, 3, 512)])
def test_an_organised_array_with_its_coordinates_first_is_rejected(shape: tuple[int, ...]) -> None:
    with pytest.raises(MalformedScan, match=r"wanted .*\(h, w, 3\).*: is it transposed\?$"):
        NpyFormat().read(npy(np.ones(shape)))


def test_doubles_beyond_float32_are_no_returns() -> None:
    scan = read_scan(npy(np.array([[1e300, 0, 0], [1.0, 2, 3]])), min_returns=1)
    assert (len(scan), scan.dropped_returns) == (1, 1)


@pytest.mark.parametrize("dtype", ["i4", "u1", "c8", "?", "f16", "S4", "M8[s]"])
def test_arrays_of_anything_but_floats_are_rejected(dtype: str) -> None:
    with pytest.raises(WrongDtype, match="wanted float16, float32 or float64 metres"):
        NpyFormat().read(npy(np.zeros((3, 3), dtype)))


def test_an_array_of_objects_is_rejected_unread() -> None:
    with pytest.raises(WrongDtype):
        NpyFormat().read(npy(np.full((3, 3), None, dtype=object), allow_pickle=True))


def test_a_structured_array_without_float_axes_is_rejected_naming_the_field() -> None:
    with pytest.raises(WrongDtype, match="field y holds <i4"):
        NpyFormat().read(npy(np.zeros(3, [("x", "<f4"), ("y", "<i4"), ("z", "<f4")])))
    with pytest.raises(WrongDtype, match="field z holds nothing"):
        NpyFormat().read(npy(np.zeros(3, [("x", "<f4"), ("y", "<f4")])))


@pytest.mark.parametrize("shape", [(3, 500), (4, 500), (5, 500), (9, 500)])
def test_points_in_columns_are_rejected_as_transposed(shape: tuple[int, ...]) -> None:
    with pytest.raises(MalformedScan, match=r"wanted \(n, 3\), .*: is it transposed\?$"):
        NpyFormat().read(npy(np.ones(shape)))


@pytest.mark.parametrize("shape", [(100, 101), (128, 1024)])
def test_a_range_image_is_rejected_whatever_its_number_of_beams(shape: tuple[int, int]) -> None:
    message = r"wanted \(n, 3\), up to \(n, 100\), .*: is it a range image\?$"
    with pytest.raises(MalformedScan, match=message):
        NpyFormat().read(npy(np.ones(shape, np.float32)))


@pytest.mark.parametrize("shape", [(3,), (3, 2), (3, 4, 2), (2, 3, 4, 3), (64, 1024, 5), ()])
def test_a_shape_other_than_rows_of_three_or_more_is_rejected(shape: tuple[int, ...]) -> None:
    with pytest.raises(MalformedScan, match="wanted"):
        NpyFormat().read(npy(np.ones(shape)))


def test_a_header_that_claims_terabytes_is_rejected_without_taking_them() -> None:
    body = with_header("{'descr': '<f4', 'fortran_order': False, 'shape': (10000000000000, 3)}\n")
    tracemalloc.start()
    try:
        with pytest.raises(TruncatedScan, match="takes 120000000000000 bytes, got 0"):
            NpyFormat().read(body)
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    "header",
    [
        "",
        "[]",
        "{'descr': '<f4'}",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (-1, 3)}",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (3L, 3L)}",
        "{'descr': '<f4', 'fortran_order': False, 'shape': 3}",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (True, 3)}",
        "{'descr': '\\d', 'fortran_order': False, 'shape': (1, 3)}",
        "{'descr': [('x', '<f4', 1)], 'fortran_order': False, 'shape': (1,)}",
        "{'descr': [('x', '<f4'), ('x', '<f4')], 'fortran_order': False, 'shape': (1,)}",
        "{'descr': {}, 'fortran_order': False, 'shape': (1, 3)}",
        "{{}: {}}",
        "(" * 5000,
        "{'descr': '<f4', 'fortran_order': False, 'shape': (" + "9" * 5000 + ", 3)}",
        "__import__('os')",
    ],
)
def test_a_header_of_anything_else_is_malformed(header: str) -> None:
    with pytest.raises(MalformedScan):
        NpyFormat().read(with_header(header, b"\0" * 64))


def test_an_integer_too_long_to_print_is_still_an_error_of_ours() -> None:
    header = "{'descr': '<f4', 'fortran_order': False, 'shape': (" + "9" * 4200 + ", 99)}"
    with pytest.raises(TruncatedScan):
        NpyFormat().read(with_header(header, b"\0" * 64))
    rows = ", ".join(["9" * 1100] * 8)
    structured = "[('x', '<f4'), ('y', '<f4'), ('z', '<f4')]"
    header = f"{{'descr': {structured}, 'fortran_order': False, 'shape': ({rows})}}"
    with pytest.raises(TruncatedScan, match="beyond printing"):
        NpyFormat().read(with_header(header, b"\0" * 64))


def test_the_error_for_a_body_of_another_length_has_both_lengths() -> None:
    with pytest.raises(TruncatedScan, match="takes 72 bytes, got 62"):
        NpyFormat().read(npy(POINTS)[:-10])
    with pytest.raises(MalformedScan, match="takes 72 bytes, got 73"):
        NpyFormat().read(npy(POINTS) + b"!")
    with pytest.raises(TruncatedScan, match="header takes"):
        NpyFormat().read(npy(POINTS)[:40])


def test_an_unknown_version_is_malformed() -> None:
    with pytest.raises(MalformedScan, match=r"version \(9, 0\)"):
        NpyFormat().read(b"\x93NUMPY\x09\x00" + npy(POINTS)[8:])
