"""Columns of numbers as text: what is found, limits, and what is rejected."""

import numpy as np
import pytest

from storage.formats.budget import BUDGET
from storage.formats.errors import MalformedScan, ScanTooLarge
from storage.formats.scans import text_numbers
from storage.formats.scans.delimited import CsvFormat


class TestCsv:
    @pytest.mark.parametrize(
        "text",
        [
            "x,y,z\n1,2,3\n4,5,6\n",
            "\ufeffx,y,z\r\n1,2,3\r\n4,5,6\r\n",
            'intensity;Z (m);x_m;"y"\n0;3;1;2\n0;6;4;5',
            "x (metres),y ( meter ),z (M)\n1,2,3\n4,5,6\n",
            "x,y,z,speed (ft/s)\n1,2,3,0\n4,5,6,0\n",
            "1 2 3 99\n\n4 5 6 99\n",
            "  1   2   3\n  4   5   6\n",
            "x\ty\tz\n1\t2\t3\n4\t5\t6\n\n",
            "1.0 , 2.0 , 3.0\n4.0 , 5e0 , 6.0\n",
            "# x y z i\n1 2 3 7\n4 5 6 8\n",
            "# i,x,y,z\n7,1,2,3\n8,4,5,6\n",
            "//X Y Z\n1 2 3\n4 5 6\n",
            "x [m],y [metres],z(m)\n1,2,3\n4,5,6\n",
            "x (m) y [m]  z (m)\n1 2 3\n4 5 6\n",
            "x y z (refl)\n1 2 3 9\n4 5 6 9\n",
            "# i z [m] y(m) x (metres) speed (ft/s)\n7 3 2 1 0\n8 6 5 4 0\n",
            ",x,y,z\n0,1,2,3\n1,4,5,6\n",
            "\tx\ty\tz\n0\t1\t2\t3\n1\t4\t5\t6\n",
            "x\ty\tz\t\n1\t2\t3\t\n4\t5\t6\t\n",
            "1\t2\t3\t\r\n4\t5\t6\t\r\n",
            "1 2 3\t\n4 5 6\t\n",
            "x,y,z\r1,2,3\r4,5,6\r",
            "\r\r# x y z i\r1 2 3 7\r4 5 6 8",
            "1,2,3\r4,5,6\r",
            "x\ty\tz\t\r1\t2\t3\t\r4\t5\t6\t\r",
        ],
    )
    def test_columns_are_found(self, text: str) -> None:
        np.testing.assert_array_equal(CsvFormat().read(text.encode()), [[1, 2, 3], [4, 5, 6]])

    @pytest.mark.parametrize(
        ("head", "message"),
        [
            ("x (ft),y (ft),z (ft)", "column x is in 'ft', wanted metres"),
            ("x [mm],y [mm],z [mm]", "column x is in 'mm', wanted metres"),
            ("x (m) y (km) z (m)", "column y is in 'km', wanted metres"),
            ("(m) x (m) y (m)", "wanted one column z"),
            ("x,y, Z (CM)", "column z is in 'cm', wanted metres"),
            ('"x_m (mm)",y,z', "column x is in 'mm', wanted metres"),
            ("x (m),y (km,z (m)", "column y is in 'km', wanted metres"),
        ],
    )
    def test_a_column_that_is_not_in_metres_is_rejected_with_its_unit(
        self, head: str, message: str
    ) -> None:
        with pytest.raises(MalformedScan, match=message):
            CsvFormat().read(f"{head}\n1,2,3\n".encode())

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
            b"x,y,z" + b" " * 20_000 + b"\r1,2,3",
            b"# 1,2,3\n4,5,6\n",
            b"# lidar, front\nx,y,z\n1,2,3\n",
            bytes(100),
        ],
    )
    def test_what_has_no_three_columns_of_numbers_is_rejected(self, body: bytes) -> None:
        with pytest.raises(MalformedScan):
            CsvFormat().read(body)


@pytest.mark.parametrize("line", [b"\n", b"1,2,3\n"])
def test_the_number_of_lines_is_bounded_by_the_budget(
    line: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(text_numbers, "BUDGET", BUDGET.__class__(text_returns=100))
    with pytest.raises(ScanTooLarge, match="more than 100 lines"):
        CsvFormat().read(b"x,y,z\n" + line * 101)


def test_blank_lines_line_ends_of_all_kinds_and_blocks_do_not_change_what_is_read(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(text_numbers, "_BLOCK_BYTES", 16)
    body = b"x,y,z\r\n1,2,3\r\n\r\n \n4, 5,6\r7,8,9\r\n\n10,11,12"
    assert CsvFormat().read(body).tolist() == [[1, 2, 3], [4, 5, 6], [7, 8, 9], [10, 11, 12]]


@pytest.mark.parametrize("bad", ["1,2", "1,2,3,4", "1,2,x", "1,,3", "1,2,0x3", "1,2,3\u00b2"])
def test_a_line_that_is_wrong_among_many_is_rejected(bad: str) -> None:
    lines = ["1,2,3"] * 500
    lines[321] = bad
    with pytest.raises(MalformedScan):
        CsvFormat().read("\n".join(["x,y,z", *lines]).encode())


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_a_line_with_nothing_in_all_three_columns_is_a_no_return(delimiter: str) -> None:
    text = "ring,x,y,z\n7,1,2,3\n8,,,\n,, ,\n9,4,5,6\n".replace(",", delimiter)
    returns_m = CsvFormat().read(text.encode())
    np.testing.assert_array_equal(returns_m[[0, 3]], [[1, 2, 3], [4, 5, 6]])
    assert np.isnan(returns_m[1:3]).all()


@pytest.mark.parametrize(("bad", "reason"), [("1,2", "wanted 3 columns"), ("1,x,3", "'x'")])
def test_the_error_names_the_line_of_the_file(
    bad: str, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(text_numbers, "_BLOCK_BYTES", 64)
    lines = ["", "x,y,z", *["1,2,3"] * 100]
    lines[70] = bad
    for end in ("\r\n", "\r", "\n"):
        with pytest.raises(MalformedScan, match=f"^line 71: .*{reason}"):
            CsvFormat().read(end.join(lines).encode())
    with pytest.raises(MalformedScan, match=f"^line 69: .*{reason}"):
        CsvFormat().read("\n".join(lines[2:]).encode())


@pytest.mark.parametrize("lines", [b"", b"\n", b" \n\n"])
def test_a_table_without_a_line_has_no_points(lines: bytes) -> None:
    assert CsvFormat().read(b"x,y,z\n" + lines).shape == (0, 3)
