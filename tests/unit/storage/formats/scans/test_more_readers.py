"""Readers of files and records that scanners and data sets write: what each does and refuses."""

import struct
import zlib
from io import BytesIO

import laspy
import numpy as np
import pytest
from scipy.io import savemat

from core.errors import InvalidScan
from storage.formats.errors import MalformedScan, ScanTooLarge, TruncatedScan, WrongDtype
from storage.formats.scans.delimited import CsvFormat
from storage.formats.scans.ford import FordFormat
from storage.formats.scans.las import LasFormat
from storage.formats.scans.ply import PlyFormat
from storage.formats.scans.records import NcltFormat, NuscenesFormat

POINTS = np.random.default_rng(0).normal(scale=20.0, size=(300, 3)).astype(np.float32)


def las(*, compress: bool, version: str = "1.2", point_format: int = 0) -> bytes:
    header = laspy.LasHeader(point_format=point_format, version=version)
    header.scales, header.offsets = np.full(3, 1e-3), np.array([100.0, -100.0, 5.0])
    data = laspy.LasData(header)
    data.x, data.y, data.z = POINTS.T.astype(np.float64)
    file = BytesIO()
    data.write(file, do_compress=compress)
    return file.getvalue()


def patched(body: bytes, at: int, layout: str, value: int) -> bytes:
    changed = bytearray(body)
    struct.pack_into(layout, changed, at, value)
    return bytes(changed)


class TestLas:
    @pytest.mark.parametrize("compress", [False, True], ids=["las", "laz"])
    @pytest.mark.parametrize(("version", "point_format"), [("1.2", 3), ("1.4", 6)])
    def test_scale_and_offset_are_applied(
        self, compress: bool, version: str, point_format: int
    ) -> None:
        body = las(compress=compress, version=version, point_format=point_format)
        np.testing.assert_allclose(LasFormat().read(body), POINTS, rtol=0, atol=6e-4)

    @pytest.mark.parametrize(
        ("body", "error"),
        [
            (las(compress=False)[:-1], TruncatedScan),
            (las(compress=False)[:100], TruncatedScan),
            (patched(las(compress=False), 107, "<I", 301), TruncatedScan),
            (patched(las(compress=False), 107, "<I", 2**32 - 1), ScanTooLarge),
            (patched(las(compress=True), 107, "<I", 2**32 - 1), ScanTooLarge),
            (patched(las(compress=False), 105, "<H", 0), MalformedScan),
            (patched(las(compress=False), 100, "<I", 2**32 - 1), MalformedScan),
            (patched(las(compress=False), 96, "<I", 2**32 - 1), TruncatedScan),
            (patched(las(compress=False), 94, "<H", 0), MalformedScan),
            (patched(las(compress=False), 25, "<B", 9), MalformedScan),
            (patched(las(compress=False), 104, "<B", 60), MalformedScan),
            (patched(las(compress=False), 131, "<Q", 0x7FF8 << 48), MalformedScan),
            (b"LASX" + las(compress=False)[4:], MalformedScan),
        ],
    )
    def test_a_header_that_lies_is_refused(self, body: bytes, error: type[InvalidScan]) -> None:
        with pytest.raises(error):
            LasFormat().read(body)

    def test_compressed_points_that_ask_for_gigabytes_end_no_process_but_their_own(self) -> None:
        whole = las(compress=True, version="1.4", point_format=6)
        points_at = struct.unpack_from("<I", whole, 96)[0]
        # The sizes of the layers stand behind the first point.
        sizes_at = points_at + 8 + 30 + 4
        lying = whole[:sizes_at] + b"\xff" * 36 + whole[sizes_at + 36 :]
        for body in (lying, whole[: points_at + 20]):
            with pytest.raises(MalformedScan, match="cannot be unpacked"):
                LasFormat().read(body)


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
    def test_a_header_that_lies_is_refused(
        self, head: str, rest: bytes, error: type[InvalidScan]
    ) -> None:
        with pytest.raises(error):
            PlyFormat().read(head.encode() + rest)


class TestCsv:
    @pytest.mark.parametrize(
        "text",
        [
            "x,y,z\n1,2,3\n4,5,6\n",
            "\ufeffx,y,z\r\n1,2,3\r\n4,5,6\r\n",
            'intensity;Z (m);x_m;"y"\n0;3;1;2\n0;6;4;5',
            "1 2 3 99\n\n4 5 6 99\n",
            "  1   2   3\n  4   5   6\n",
            "x\ty\tz\n1\t2\t3\n4\t5\t6\n\n",
            "1.0 , 2.0 , 3.0\n4.0 , 5e0 , 6.0\n",
        ],
    )
    def test_columns_are_found(self, text: str) -> None:
        np.testing.assert_array_equal(CsvFormat().read(text.encode()), [[1, 2, 3], [4, 5, 6]])

    def test_text_longer_than_a_block_is_read_whole(self) -> None:
        points = np.arange(300_000, dtype=np.float32).reshape(-1, 3)
        text = "\n".join(f"{x},{y},{z}" for x, y, z in points.tolist())
        assert len(text) > 2**21
        np.testing.assert_array_equal(CsvFormat().read(text.encode()), points)

    @pytest.mark.parametrize(
        "body",
        [
            b"\n\n",
            b"hello\n",
            b"x,y\n1,2\n",
            b"x,x,y,z\n1,2,3,4\n",
            b"a,b,c\n1,2,3\n",
            b"1,2\n",
            b"x,y,z\n1,2,3\n4,5\n",
            b"x,y,z\n1,2,three\n",
            b"x,y,z\n" + b"1" * 2**21,
            b"9" * 20_000,
            bytes(100),
        ],
    )
    def test_what_has_no_three_columns_of_numbers_is_refused(self, body: bytes) -> None:
        with pytest.raises(MalformedScan):
            CsvFormat().read(body)


def mat(variables: dict[str, object], *, compress: bool = False) -> bytes:
    file = BytesIO()
    # SciPy writes to open files too, its stubs do not know.
    savemat(file, variables, do_compression=compress)  # type: ignore[arg-type]
    return file.getvalue()


class TestFord:
    @pytest.mark.parametrize("compress", [False, True])
    @pytest.mark.parametrize("dtype", [np.float64, np.float32])
    def test_points_are_read_whatever_stands_around_them(
        self, compress: bool, dtype: type[np.floating]
    ) -> None:
        scan = {"X_wv": np.zeros((6, 1)), "XYZ": POINTS.T.astype(dtype), "note": "hello"}
        body = mat({"PARAM": {"a": 1}, "SCAN": scan}, compress=compress)
        np.testing.assert_array_equal(FordFormat().read(body), POINTS)

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
    def test_what_has_no_points_is_refused(self, variables: dict[str, object]) -> None:
        with pytest.raises(MalformedScan):
            FordFormat().read(mat(variables))

    def test_a_bomb_is_not_unpacked(self) -> None:
        packed = zlib.compress(bytes(2**22))
        body = mat({"SCAN": 1})[:128] + struct.pack("<II", 15, len(packed)) + packed
        with pytest.raises(ScanTooLarge):
            FordFormat(max_decoded_bytes=2**20).read(body)

    def test_each_element_is_compared_with_what_came(self) -> None:
        whole = mat({"SCAN": {"XYZ": POINTS.T.astype(np.float64)}})
        for end in range(0, len(whole) - 8, 97):
            with pytest.raises((TruncatedScan, MalformedScan)):
                FordFormat().read(whole[:end])


class TestRecords:
    def test_nclt_points_are_turned_up_and_moved_to_the_lidar(self) -> None:
        # The vehicle's origin, and a point 1 m ahead of it, to its right and below it.
        raw = np.array([[20000, 20000, 20000], [20200, 20200, 20200]], "<u2")
        body = b"".join(row.tobytes() + b"\x07\x05" for row in raw)
        np.testing.assert_allclose(
            NcltFormat().read(body), [[-0.002, -0.004, -0.957], [0.998, -1.004, -1.957]], atol=1e-6
        )

    @pytest.mark.parametrize("dtype", ["<f4", "<f8"])
    def test_floats_are_not_taken_for_nclt(self, dtype: str) -> None:
        body = np.pad(POINTS, ((0, 0), (0, 1))).astype(dtype).tobytes()
        with pytest.raises(WrongDtype, match="laser"):
            NcltFormat().read(body)

    def test_kitti_is_not_taken_for_nuscenes(self) -> None:
        body = np.pad(POINTS, ((0, 0), (0, 1)), constant_values=0.3).astype("<f4").tobytes()
        assert len(body) % 20 == 0
        with pytest.raises(WrongDtype, match="ring"):
            NuscenesFormat().read(body)

    @pytest.mark.parametrize("known", [NuscenesFormat(), NcltFormat()])
    def test_a_part_of_a_record_is_refused(self, known: NuscenesFormat | NcltFormat) -> None:
        with pytest.raises(TruncatedScan):
            known.read(bytes(39))
