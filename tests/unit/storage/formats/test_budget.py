"""What a stranger's bytes may cost: limits that are named, and work that grows with the length."""

import gzip
import io
import math
import struct
from collections.abc import Callable

import numpy as np
import pytest
import zstandard

from app.drives.pose_files import CSV, KITTI, TUM, read_poses
from app.drives.tar_stream import TarStream
from app.http.bodies.content_encoding import decoder_of
from app.http.errors import BodyTooLarge, MalformedBody, MalformedUpload
from core.errors import InvalidPose
from storage.formats.budget import BUDGET
from storage.formats.errors import MalformedScan, ScanTooLarge
from storage.formats.scans import pcap as captures
from storage.formats.scans import text_numbers
from storage.formats.scans.delimited import CsvFormat
from storage.formats.scans.ford import FordFormat
from storage.formats.scans.kitti import KittiFormat
from storage.formats.scans.registry import FORMAT_NAMES, read_scan
from tests.support.captures import hdl32, pcap, udp
from tests.support.recording import tar


def test_a_scan_has_at_most_as_many_returns_as_the_budget_says() -> None:
    with pytest.raises(ScanTooLarge, match=r"4194305 returns, at most 4194304 may be"):
        KittiFormat().read(bytes(16 * (2**22 + 1)))


@pytest.mark.parametrize("line", [b"\n", b"1,2,3\n"])
def test_a_text_has_at_most_as_many_lines_as_the_budget_says(
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
def test_a_line_that_is_wrong_among_many_is_refused(bad: str) -> None:
    lines = ["1,2,3"] * 500
    lines[321] = bad
    with pytest.raises(MalformedScan):
        CsvFormat().read("\n".join(["x,y,z", *lines]).encode())


def fragments(payload: bytes, step: int) -> list[bytes]:
    frames: list[bytes] = udp(payload, 2368, fragment_bytes=step, number=7)
    return frames


def test_fragments_are_joined_in_any_order_and_once(monkeypatch: pytest.MonkeyPatch) -> None:
    joined: list[int] = []
    join = captures._Partial.joined

    def counted(partial: captures._Partial) -> bytes | None:
        joined.append(len(partial.parts))
        return join(partial)

    monkeypatch.setattr(captures._Partial, "joined", counted)
    frames = fragments(bytes(range(200)) * 6, 64)
    for order in (frames, frames[::-1], [*frames[:4], frames[2], *frames[4:]]):
        (found,) = captures.datagrams(pcap(order))
        assert found.payload == bytes(range(200)) * 6
    assert joined == [len(frames)] * 3


def test_fragments_that_overlap_or_are_too_many_are_no_datagram() -> None:
    frames = fragments(bytes(1200), 64)
    overlapping = [*frames[:3], frames[0][:20] + frames[1][20:22] + frames[0][22:], *frames[3:]]
    assert len(list(captures.datagrams(pcap(frames)))) == 1
    assert not list(captures.datagrams(pcap(overlapping[:-2])))
    many = fragments(bytes(8 * (BUDGET.fragments + 8)), 8)
    assert not list(captures.datagrams(pcap(many[: BUDGET.fragments + 1])))


def test_a_capture_of_little_but_heads_of_packets_is_refused() -> None:
    record = struct.pack("<IIII", 1, 0, 0, 0)
    with pytest.raises(MalformedScan, match="must average 256 bytes"):
        list(captures.datagrams(pcap([]) + record * 20_000))


def test_a_packet_has_at_most_a_few_vlan_tags() -> None:
    (frame,) = udp(hdl32(turns=0.01)[0], 2368)
    for tags, found in ((2, 1), (BUDGET.vlan_tags, 1), (BUDGET.vlan_tags + 1, 0), (10_000, 0)):
        tagged = frame[:12] + b"\x81\0\0\x05" * tags + frame[12:]
        assert len(list(captures.datagrams(pcap([tagged])))) == found


def test_a_mat_file_of_empty_elements_is_refused_after_a_thousand() -> None:
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM"
    with pytest.raises(MalformedScan, match="first 1000 elements"):
        FordFormat().read(head + struct.pack("<II", 9, 0) * 2000)


PACK: dict[str, Callable[[bytes], bytes]] = {"gzip": gzip.compress, "zstd": zstandard.compress}


def unpacked(body: bytes, encoding: str, step: int = 50_000) -> int:
    decoder = decoder_of(encoding)
    assert decoder is not None
    count = 0
    for start in range(0, len(body), step):
        count += sum(len(piece) for piece in decoder.feed(body[start : start + step]))
    decoder.finish()
    return count


@pytest.mark.parametrize("encoding", PACK)
class TestPackedBodies:
    def test_empty_members_are_bounded(self, encoding: str) -> None:
        assert unpacked(PACK[encoding](b"") * 900, encoding) == 0
        with pytest.raises(MalformedBody, match="more than 1000 members"):
            unpacked(PACK[encoding](b"") * 1100, encoding)

    def test_members_as_bgzip_makes_them_are_not(self, encoding: str) -> None:
        block = np.random.default_rng(0).bytes(16 * 2**10)
        assert unpacked(PACK[encoding](block) * 2000, encoding) == 2000 * len(block)

    def test_a_body_that_unpacks_to_200_times_its_size_is_refused_once_it_is_large(
        self, encoding: str
    ) -> None:
        assert unpacked(PACK[encoding](bytes(16 * 2**20)), encoding) == 16 * 2**20
        with pytest.raises(BodyTooLarge, match="more than 200 times its size"):
            unpacked(PACK[encoding](bytes(80 * 2**20)), encoding)


def headers_only(count: int) -> bytes:
    return tar([(f"{index}.bin", b"") for index in range(100)])[: 512 * 100] * (count // 100)


def test_a_tar_stream_of_headers_is_refused_and_one_of_small_files_is_read() -> None:
    def files(body: bytes) -> int:
        return sum(1 for _ in TarStream(io.BytesIO(body).read, 2**20))

    assert files(headers_only(9_000)) == 9_000
    with pytest.raises(MalformedUpload, match="more than 10000 headers"):
        files(headers_only(10_100))
    small = tar([(f"{index}.bin", bytes(512)) for index in range(100)])[: 1024 * 100]
    assert files(small * 150) == 15_000


def test_extended_headers_that_follow_one_another_are_bounded() -> None:
    header = tar([("x", b"")])[:512]
    # The sum is of all bytes, blanks in place of the sum itself.
    pax = bytearray(header[:156] + b"x" + header[157:])
    pax[148:156] = b"%06o\0 " % sum(pax[:148] + b" " * 8 + pax[156:])
    with pytest.raises(MalformedUpload, match="more than 8 extended headers"):
        list(TarStream(io.BytesIO(bytes(pax) * 9 + header).read, 2**20))


@pytest.mark.parametrize(
    ("kind", "head", "line"),
    [
        (KITTI, b"", b"1 0 0 4 0 1 0 5 0 0 1 6\n"),
        (TUM, b"", b"1.5 1 2 3 0 0 0 1\n"),
        (CSV, b"scan,x,y,z,qx,qy,qz,qw\n", b"%d,1,2,3,0,0,0,1\n"),
    ],
)
def test_the_first_wrong_line_of_many_poses_is_named(kind: str, head: bytes, line: bytes) -> None:
    count = 60_000  # more than a block of them
    lines = [line % index if b"%" in line else line for index in range(count)]
    found = read_poses(head + b"".join(lines), kind)
    assert len(found.poses) == count
    lines[50_000] = lines[55_000] = b"# a comment\n\n1 2 three\n"
    with pytest.raises(InvalidPose, match=f"^line {50_000 + 3 + bool(head)}: "):
        read_poses(head + b"".join(lines), kind)


def test_poses_that_are_left_out_are_unknown() -> None:
    body = b"scan,x,y,z,qx,qy,qz,qw,timestamp_s\n\n7,1,2,3,0,0,0,1,\n 9 , ,,,,,,,2.5\n"
    found = read_poses(body, CSV)
    nan = math.nan
    np.testing.assert_array_equal(found.scans, [7, 9])
    np.testing.assert_array_equal(found.timestamps_s, [nan, 2.5])
    np.testing.assert_array_equal(found.poses, [[1, 2, 3, 0, 0, 0, 1], [nan] * 7])


def test_a_pose_beyond_every_frame_of_the_earth_is_refused_in_a_file_too() -> None:
    with pytest.raises(InvalidPose, match="line 2: a pose is 1e"):
        read_poses(b"1 1 1 1 0 0 0 1\n2 1e9 1 1 0 0 0 1\n", TUM)


def test_a_sensor_that_turns_too_slowly_gives_no_scan_of_any_size() -> None:
    frames = [f for p in hdl32(turns=0.01) for f in udp(p, 2368)]
    body = pcap(frames)[:24] + pcap(frames)[24:] * (BUDGET.scan_packets + 1)
    with pytest.raises(ScanTooLarge, match="more than 200000 packets"):
        read_scan(body, media_type=FORMAT_NAMES["velodyne"], min_returns=1)
