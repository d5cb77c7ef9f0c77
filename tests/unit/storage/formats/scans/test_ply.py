"""PLY: text and both byte orders, other properties, and headers that lie."""

import numpy as np
import pytest

from core.errors import InvalidScan
from storage.formats.errors import MalformedScan, TruncatedScan, WrongDtype
from storage.formats.scans.ply import PlyFormat
from storage.formats.scans.registry import read_scan

POINTS = np.random.default_rng(0).normal(scale=20.0, size=(300, 3)).astype(np.float32)


class TestPly:
    HEAD = "ply\nformat {} 1.0\ncomment x\nelement vertex {}\n{}end_header\n"
    XYZ = "property float x\nproperty float y\nproperty float z\n"

    def test_other_properties_and_elements_are_skipped(self) -> None:
        head = (
            "ply\nformat ascii 1.0\nelement vertex 2\nproperty uchar red\nproperty double z\n"
            "property double x\nproperty double y\nelement face 1\n"
            "property list uchar int vertex_indices\nend_header\n"
        )
        body = head.encode() + b"255 3 1 2\n0 6 4 5\n3 0 1 1\n"
        np.testing.assert_array_equal(PlyFormat().read(body), [[1, 2, 3], [4, 5, 6]])

    @pytest.mark.parametrize("searched_bytes", [1, 2, 3, 5, 2**20])
    @pytest.mark.parametrize("blank", ["", " \t", "\r"])
    @pytest.mark.parametrize("behind", [True, False])
    def test_blank_lines_between_vertices_are_passed_over(
        self, blank: str, behind: bool, searched_bytes: int, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("storage.formats.scans.ply._SEARCHED_BYTES", searched_bytes)
        face = "element face 1\nproperty list uchar int vertex_indices\n" if behind else ""
        head = self.HEAD.format("ascii", 3, self.XYZ + face)
        lines = ["10 0 -1", blank, "1 2 3", blank, blank, "4 5 6", blank]
        body = "\n".join([*lines, "3 0 1 2\n"] if behind else lines)
        points = PlyFormat().read((head + body).encode())
        np.testing.assert_array_equal(points, [[10, 0, -1], [1, 2, 3], [4, 5, 6]])

    @pytest.mark.parametrize(
        ("head", "message"),
        [
            (
                HEAD.format("ascii", 1, XYZ).replace("\n", "\r"),
                "lines end in carriage returns only",
            ),
            (
                HEAD.format("ascii", 1, f"{XYZ}property list uchar int ids\n"),
                "'list', 'uchar', 'int', 'ids'. gives each vertex a list, wanted properties of",
            ),
            (HEAD.format("ascii", 1, f"{XYZ}property half w\n"), "is no property of fixed size"),
        ],
    )
    def test_the_message_says_what_is_wrong_in_a_header(self, head: str, message: str) -> None:
        with pytest.raises(MalformedScan, match=message):
            read_scan(f"{head}1 2 3\n".encode(), suffix=".ply", min_returns=1)

    def test_blank_lines_are_no_vertices(self) -> None:
        head = self.HEAD.format("ascii", 3, f"{self.XYZ}element face 0\n")
        with pytest.raises(TruncatedScan, match="claims 3 vertices, got 2"):
            PlyFormat().read(f"{head}1 2 3\n\n\n4 5 6\n".encode())

    @pytest.mark.parametrize("order", ["<", ">"])
    def test_binary_records_are_read_in_both_orders(self, order: str) -> None:
        name = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
        head = self.HEAD.format(name, len(POINTS), f"{self.XYZ}property short ring\n")
        records = np.zeros(len(POINTS), f"{order}f4,{order}f4,{order}f4,{order}i2")
        for axis in range(3):
            records[f"f{axis}"] = POINTS[:, axis]
        np.testing.assert_array_equal(PlyFormat().read(head.encode() + records.tobytes()), POINTS)

    @pytest.mark.parametrize(
        ("head", "rest", "error"),
        [
            (HEAD.format("binary_little_endian", 10**14, XYZ), bytes(12), TruncatedScan),
            (HEAD.format("binary_little_endian", 1, XYZ), bytes(13), MalformedScan),
            (HEAD.format("ascii", 10**14, XYZ), b"1 2 3\n", TruncatedScan),
            (HEAD.format("ascii", 1, XYZ), b"1 2 3\n4 5 6\n", MalformedScan),
            (HEAD.format("ascii", 1, XYZ), b"1 2\n", MalformedScan),
            (HEAD.format("ascii", 1, XYZ), b"1 2 a\n", MalformedScan),
            (HEAD.format("ascii", "-1", XYZ), b"", MalformedScan),
            (HEAD.format("ascii", "9" * 30, XYZ), b"", MalformedScan),
            (HEAD.format("utf8", 1, XYZ), b"1 2 3\n", MalformedScan),
            (HEAD.format("ascii", 1, XYZ.replace("float", "int")), b"1 2 3\n", WrongDtype),
            (HEAD.format("ascii", 1, "property float x\n"), b"1\n", WrongDtype),
            (HEAD.format("ascii", 1, XYZ + XYZ), b"1 2 3 4 5 6\n", MalformedScan),
            (HEAD.format("ascii", 1, "property list uchar int i\n"), b"", MalformedScan),
            ("ply\nend_header\n", b"", MalformedScan),
            ("ply\nformat ascii 1.0\n" + "comment\n" * 5000, b"", MalformedScan),
            ("not\nformat ascii 1.0\nend_header\n", b"", MalformedScan),
        ],
    )
    def test_a_wrong_header_is_rejected(
        self, head: str, rest: bytes, error: type[InvalidScan]
    ) -> None:
        with pytest.raises(error):
            PlyFormat().read(head.encode() + rest)
