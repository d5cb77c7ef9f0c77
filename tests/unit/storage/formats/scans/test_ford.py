"""Scans of the Ford Campus data set: MATLAB files."""

import struct
import zlib
from io import BytesIO

import numpy as np
import pytest
from scipy.io import savemat

from storage.formats.budget import Budget
from storage.formats.errors import MalformedScan, ScanTooLarge, TruncatedScan
from storage.formats.scans import ford
from storage.formats.scans.ford import FordFormat

POINTS = np.random.default_rng(0).normal(scale=20.0, size=(300, 3)).astype(np.float32)


def mat(variables: dict[str, object], *, compress: bool = False) -> bytes:
    file = BytesIO()
    # SciPy writes to open files too, its stubs do not know.
    savemat(file, variables, do_compression=compress)  # type: ignore[arg-type]
    return file.getvalue()


class TestFord:
    @pytest.mark.parametrize("compress", [False, True])
    @pytest.mark.parametrize("dtype", [np.float64, np.float32])
    def test_points_are_read_among_any_other_fields(
        self, compress: bool, dtype: type[np.floating]
    ) -> None:
        scan = {"X_wv": np.zeros((6, 1)), "XYZ": POINTS.T.astype(dtype), "note": "hello"}
        body = mat({"PARAM": {"a": 1}, "SCAN": scan}, compress=compress)
        np.testing.assert_array_equal(FordFormat().read(body), POINTS)

    @pytest.mark.parametrize("dtype", [np.int64, np.uint64, np.int32, np.int16])
    def test_integers_of_every_size_are_numbers(self, dtype: type[np.integer]) -> None:
        points = np.round(np.abs(POINTS))
        body = mat({"SCAN": {"time_us": dtype(12_345), "XYZ": points.T.astype(dtype)}})
        np.testing.assert_array_equal(FordFormat().read(body), points)
        found = ford.scan_matrices(body, {"time_us"})
        assert found["time_us"].tolist() == [[12_345]]

    @pytest.mark.parametrize(
        "variables",
        [
            {"OTHER": 1},
            {"SCAN": 1},
            {"SCAN": {"X_wv": np.zeros((6, 1))}},
            {"SCAN": {"XYZ": POINTS}},
            {"SCAN": {"XYZ": POINTS.T * 1j}},
            {"SCAN": {"XYZ": "text"}},
            {"SCAN": {"XYZ": {"a": 1}}},
        ],
    )
    def test_a_file_without_points_is_rejected(self, variables: dict[str, object]) -> None:
        with pytest.raises(MalformedScan):
            FordFormat().read(mat(variables))

    def test_a_bomb_is_not_unpacked(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(ford, "BUDGET", Budget(unpacked_bytes=2**20))
        packed = zlib.compress(bytes(2**22))
        body = mat({"SCAN": 1})[:128] + struct.pack("<II", 15, len(packed)) + packed
        with pytest.raises(ScanTooLarge):
            FordFormat().read(body)

    def test_the_size_of_each_element_is_compared_with_the_body(self) -> None:
        whole = mat({"SCAN": {"XYZ": POINTS.T.astype(np.float64)}})
        for end in range(0, len(whole) - 8, 97):
            with pytest.raises((TruncatedScan, MalformedScan)):
                FordFormat().read(whole[:end])


def test_a_mat_file_of_empty_elements_is_rejected_after_a_thousand() -> None:
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM"
    with pytest.raises(MalformedScan, match="first 1000 elements"):
        FordFormat().read(head + struct.pack("<II", 9, 0) * 2000)
