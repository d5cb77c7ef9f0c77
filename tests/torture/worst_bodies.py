"""The worst bodies that were thought of, for every reader, as large as the service takes them.

Each maker takes `size`, the bytes that a body may have, unpacked, and returns a body near it. Run
as a program, this module makes one, reads it, and prints what that cost.
"""

import gzip
import io
import json
import struct
import sys
import zlib
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import laspy
import lzf
import numpy as np
import zstandard

from app.drives.pose_files import CSV, KITTI, MOST_LINES, TUM, read_poses
from app.drives.tar_scans import member_scan as read_member
from app.http.bodies.content_encoding import decoder_of
from app.localization.scan_queries import TAR, read_query
from app.localization.sensor_schemas import SensorIn
from app.settings import Settings
from core.errors import TensorMapError
from core.scans.accumulation import MOST_SCANS
from storage.formats.scans.registry import FORMAT_NAMES, read_scan
from tests.support.captures import hdl32, ouster, ouster_metadata, udp
from tests.support.recording import tar, tar_members
from tests.torture.support.costs import cost_of

UNPACKED, SENT = 256 * 2**20, 64 * 2**20
_PCAP = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1)
_PLY = "ply\nformat {} 1.0\nelement vertex {}\n{}end_header\n"
_KITTI = FORMAT_NAMES["kitti"]
_TEXT_SCAN = b"x,y,z\n" + b"-12.345678,23.456789,-1.234567\n" * 30_000
_TABLE = b"scan,x,y,z,qx,qy,qz,qw\n"
_WIDE = b" ".join(b"%.18f" % v for v in (1, 0, 0, 7, 0, 1, 0, 7, 0, 0, 1, 7)) + b"\n"
_FLOATS = "".join(f"property float {axis}\n" for axis in "xyz")

Read = Callable[[bytes], object]
Make = Callable[[int], bytes]


def _lines(line: bytes, size: int, most: int = 10**9) -> bytes:
    return line * min(size // len(line), most)


def _captured(frames: list[bytes], size: int) -> bytes:
    records = b"".join(struct.pack("<IIII", 1, 0, len(f), len(f)) + f for f in frames)
    return _PCAP + records * (size // len(records))


def _ply(line: bytes, size: int, properties: int = 0) -> bytes:
    more = "".join(f"property float p{number}\n" for number in range(properties))
    points = min(size // len(line), 2_000_000)
    return _PLY.format("ascii", points, _FLOATS + more).encode() + line * points


def _pcd(fields: int, encoding: str, points: int, body: bytes) -> bytes:
    names = ["x", "y", "z", *(f"f{n}" for n in range(fields - 3))]
    head = (
        f"VERSION .7\nFIELDS {' '.join(names)}\nSIZE {'4 ' * fields}\nTYPE {'F ' * fields}\n"
        f"COUNT {'1 ' * fields}\nWIDTH {points}\nHEIGHT 1\nPOINTS {points}\nDATA {encoding}\n"
    )
    return head.encode() + body


def _pcd_packed(size: int) -> bytes:
    points = min(size, 128 * 2**20) // 32
    packed = lzf.compress(bytes(points * 32))
    return _pcd(
        8, "binary_compressed", points, struct.pack("<II", len(packed), points * 32) + packed
    )


def _element(kind: int, content: bytes) -> bytes:
    return struct.pack("<II", kind, len(content)) + content


def _mat(elements: bytes) -> bytes:
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM" + elements


def _las(points: int, *, packed: bool) -> bytes:
    header = laspy.LasHeader(point_format=0, version="1.2")
    header.scales = np.full(3, 1e-4)
    data = laspy.LasData(header)
    data.x, data.y, data.z = np.random.default_rng(0).normal(scale=20.0, size=(3, points))
    file = io.BytesIO()
    data.write(file, do_compress=packed)
    return file.getvalue()


def _fragments(size: int, number: int = 0, *, step: int = 8) -> list[bytes]:
    """Return as many pieces of one datagram as fit, the last one never sent."""
    frames = []
    for at in range(0, min(size, 65_000), step):
        head = struct.pack(
            "!BBHHHBBH4s4s", 0x45, 0, 20 + step, number, 0x2000 | at // 8, 9, 17, 0, b"", b""
        )
        frames.append(bytes(12) + b"\x08\x00" + head + bytes(step))
    return frames


def _ouster_flips(size: int) -> bytes:
    """Return columns of which each is of another frame than the one before."""
    layout = ouster_metadata()["data_format"] | {"udp_profile_lidar": "LEGACY"}
    column = struct.pack("<QHHI", 0, 5, 1, 0) + bytes(16 * 12) + b"\xff" * 4
    other = struct.pack("<QHHI", 0, 5, 2, 0) + bytes(16 * 12) + b"\xff" * 4
    frames = udp((column + other) * 8, 7502)
    return (
        json.dumps(ouster_metadata(data_format=layout)).encode() + b"\n" + _captured(frames, size)
    )


def _scan(name: str) -> Read:
    return lambda body: read_scan(body, media_type=FORMAT_NAMES[name], min_returns=1)


def _poses(kind: str) -> Read:
    return lambda body: read_poses(body, kind)


def _unpacked(encoding: str) -> Read:
    def read(body: bytes) -> None:
        decoder = decoder_of(encoding)
        assert decoder is not None
        left = UNPACKED
        for start in range(0, len(body), 2**16):
            for piece in decoder.feed(body[start : start + 2**16]):
                left -= len(piece)
                if left < 0:
                    return
        decoder.finish()

    return read


def _tar_read(body: bytes) -> None:
    for member in tar_members(body, SENT):
        with suppress(TensorMapError):
            read_member(member, None if member.name.endswith(".csv") else _KITTI, 1)


def _big_endian(size: int) -> bytes:
    count = min(size // 12, 2**22)
    return _PLY.format("binary_big_endian", count, _FLOATS).encode() + b"\x41\0\0\0" * 3 * count


def _kitti(size: int) -> bytes:
    return struct.pack("<4f", 10, 1, 1, 0) * min(size // 16, 2**22)


def _query(size: int) -> bytes:
    """Return as many scans as become one, together with as many returns as may be."""
    scan = _kitti(size // MOST_SCANS - 4096)
    lines = b"".join(b"%d,0,0,0,0,0,0,1\n" % index for index in range(MOST_SCANS))
    return tar(
        [*((f"{index}.bin", scan) for index in range(MOST_SCANS)), ("poses.csv", _TABLE + lines)]
    )


def _query_read(body: bytes) -> object:
    sensor = SensorIn(mounting="1,0,2,1,2,3", format="kitti")
    return read_query(body, TAR, sensor, Settings(), 1.73)


def _npy(size: int) -> bytes:
    file = io.BytesIO()
    np.save(file, np.full((3, min(size // 24, 2**22)), 7.0).T)
    return file.getvalue()


def _members(body: bytes, size: int) -> bytes:
    return body * (size // len(body))


def _archive(files: int, content: bytes, size: int, suffix: str = "bin") -> bytes:
    one = tar([(f"{index}.{suffix}", content) for index in range(files)])[: -2 * 512]
    one = one[: len(one) // 512 * 512].rstrip(b"\0")
    one += bytes(-len(one) % 512)
    return one * max(size // len(one), 1)


SINGLE: dict[str, tuple[Read, Make]] = {
    "kitti: all returns": (_scan("kitti"), _kitti),
    "kitti: more than may be": (_scan("kitti"), bytes),
    "several scans of one query": (_query_read, lambda _: _query(SENT)),
    "nclt: all returns": (_scan("nclt"), lambda size: bytes(min(size, 8 * 2**22))),
    "nuscenes: all returns": (_scan("nuscenes"), lambda size: bytes(min(size // 20, 2**22) * 20)),
    "npy: doubles in columns": (_scan("npy"), _npy),
    "csv: short lines": (_scan("csv"), lambda size: b"x,y,z\n" + _lines(b"0,0,0\n", size)),
    "csv: as many as may be": (
        _scan("csv"),
        lambda size: b"x,y,z\n" + _lines(b"-12.345678,23.456789,-1.234567\n", size, 1_999_998),
    ),
    "csv: hard numbers": (
        _scan("csv"),
        lambda size: b"x,y,z\n" + _lines(b"8.5e-300,2.2e-308,8.5e-301\n", size, 1_999_998),
    ),
    "csv: many columns": (
        _scan("csv"),
        lambda size: _lines(b"1,2,3" + b",0" * 995 + b"\n", min(size, 127 * 2**20)),
    ),
    "csv: no-returns of many columns": (
        _scan("csv"),
        lambda size: _lines(b"1,2,3" + b",0" * 60 + b"\n", 130)
        + _lines(b"," * 62 + b"\n", min(size, 127 * 2**20), 1_999_990),
    ),
    "csv: blank lines": (_scan("csv"), lambda size: b"1,2,3\n" + _lines(b"\n", size)),
    "csv: a blank line each": (
        _scan("csv"),
        lambda size: b"1,2,3\n" + _lines(b"1,2,3\n \n", size, 999_998),
    ),
    "csv: one line": (_scan("csv"), lambda size: b"1,2,3\n" + b"1" * size),
    "csv: the last line is wrong": (
        _scan("csv"),
        lambda size: b"x,y,z\n" + _lines(b"1.5,2.5,3.5\n", size, 1_999_990) + b"1,2\n",
    ),
    "csv: long numbers": (
        _scan("csv"),
        lambda size: _lines((b"1" * 5000 + b",") * 2 + b"3\n", min(size, 127 * 2**20)),
    ),
    "ply: text": (_scan("ply"), lambda size: _ply(b"1.5 2.5 3.5\n", size)),
    "ply: text of many columns": (
        _scan("ply"),
        lambda size: _ply(b"1 " * 500 + b"\n", min(size, 120 * 2**20), 497),
    ),
    "ply: binary": (_scan("ply"), _big_endian),
    "pcd: text": (
        _scan("pcd"),
        lambda size: _pcd(3, "ascii", 1_999_990, _lines(b"1.5 2.5 3.5\n", size, 1_999_990)),
    ),
    "pcd: binary of many fields": (
        _scan("pcd"),
        lambda size: _pcd(1000, "binary", size // 4000, bytes(size // 4000 * 4000)),
    ),
    "pcd: packed zeros": (_scan("pcd"), _pcd_packed),
    "las: all returns": (_scan("las"), lambda size: _las(min(size // 20, 2**22), packed=False)),
    "laz: all returns": (_scan("las"), lambda size: _las(2**22, packed=True)),
    "ford: empty elements": (_scan("ford"), lambda size: _mat(_members(_element(9, b""), size))),
    "ford: packed elements": (
        _scan("ford"),
        lambda size: _mat(_element(15, zlib.compress(_element(9, bytes(100 * 2**20)))) * 200),
    ),
    "velodyne: no packets": (_scan("velodyne"), lambda size: _captured([b""], size)),
    "velodyne: quadratic fragments": (
        _scan("velodyne"),
        lambda size: _captured(_fragments(65_000), size),
    ),
    "velodyne: large fragments": (
        _scan("velodyne"),
        lambda size: _captured(_fragments(65_000, step=256), size),
    ),
    "velodyne: VLAN tags": (
        _scan("velodyne"),
        lambda size: _captured([bytes(12) + b"\x81\0\0\0" * 65_000], size),
    ),
    "velodyne: a sensor that does not rotate": (
        _scan("velodyne"),
        lambda size: _captured(udp(hdl32(turns=0.01)[0], 2368), size),
    ),
    "ouster: no packets": (
        _scan("ouster"),
        lambda size: json.dumps(ouster_metadata()).encode() + _captured([b""], size),
    ),
    "ouster: a frame each column": (_scan("ouster"), _ouster_flips),
    "ouster: no frame is whole": (
        _scan("ouster"),
        lambda size: json.dumps(ouster_metadata()).encode()
        + _captured([f for p in ouster(496) for f in udp(p, 7502)], size),
    ),
    "poses: KITTI": (
        _poses(KITTI),
        lambda size: _lines(b"1 0 0 4.123456789 0 1 0 5.123456789 0 0 1 6.12\n", size, MOST_LINES),
    ),
    "poses: KITTI, wide": (
        _poses(KITTI),
        lambda size: _lines(_WIDE, size, MOST_LINES),
    ),
    "poses: KITTI, the last is wrong": (
        _poses(KITTI),
        lambda size: _lines(b"1 0 0 4.1 0 1 0 5.1 0 0 1 6.1\n", size, MOST_LINES - 1) + b"1 2 3\n",
    ),
    "poses: TUM, hard numbers": (
        _poses(TUM),
        lambda size: _lines(b"8.5e-300 8.5e-300 2.2e-308 8.5e-301 0 0 0 1\n", size, MOST_LINES),
    ),
    "poses: CSV, nothing known": (
        _poses(CSV),
        lambda _: b"".join([_TABLE, *(b"%d, ,,,,,,\n" % i for i in range(MOST_LINES - 2))]),
    ),
    "poses: CSV, blank lines": (
        _poses(CSV),
        lambda size: _TABLE + _lines(b"\n", size),
    ),
    "gzip: empty members": (_unpacked("gzip"), lambda _: _members(gzip.compress(b""), SENT)),
    "gzip: members of 1 KiB": (
        _unpacked("gzip"),
        lambda _: _members(gzip.compress(bytes(1024)), SENT),
    ),
    "gzip: zeros": (_unpacked("gzip"), lambda _: gzip.compress(bytes(UNPACKED))),
    "gzip: empty blocks": (
        _unpacked("gzip"),
        lambda _: gzip.compress(b"")[:10] + _members(b"\0\0\0\xff\xff", SENT),
    ),
    "zstd: empty frames": (_unpacked("zstd"), lambda _: _members(zstandard.compress(b""), SENT)),
    "zstd: zeros": (_unpacked("zstd"), lambda _: zstandard.compress(bytes(UNPACKED))),
}  # fmt: skip
"""By name: what reads a body, and what makes it."""
REFUSED = {
    "kitti: more than may be": "ScanTooLarge",
    "nuscenes: all returns": "TooFewReturns",
    "csv: short lines": "ScanTooLarge",
    "csv: hard numbers": "TooFewReturns",
    "csv: blank lines": "ScanTooLarge",
    "csv: one line": "ScanTooLarge",
    "csv: the last line is wrong": "MalformedScan",
    "csv: long numbers": "TooFewReturns",
    "pcd: binary of many fields": "TooFewReturns",
    "pcd: packed zeros": "TooFewReturns",
    "ford: empty elements": "MalformedScan",
    "ford: packed elements": "ScanTooLarge",
    "velodyne: no packets": "MalformedScan",
    "velodyne: quadratic fragments": "MalformedScan",
    "velodyne: large fragments": "MalformedScan",
    "velodyne: VLAN tags": "MalformedScan",
    "velodyne: a sensor that does not rotate": "ScanTooLarge",
    "ouster: no packets": "MalformedScan",
    "ouster: a frame each column": "TruncatedScan",
    "ouster: no frame is whole": "TruncatedScan",
    "poses: KITTI, the last is wrong": "InvalidPose",
    "poses: CSV, blank lines": "InvalidPose",
    "gzip: empty members": "MalformedBody",
    "gzip: zeros": "BodyTooLarge",
    "gzip: empty blocks": "MalformedBody",
    "zstd: empty frames": "MalformedBody",
    "zstd: zeros": "BodyTooLarge",
}
"""The errors of those that are not read, by name."""

ARCHIVES: dict[str, tuple[Read, Make, str]] = {
    "tar: empty files": (_tar_read, lambda size: _archive(500, b"", size), "tar"),
    "tar: files of a byte": (_tar_read, lambda size: _archive(500, b"a", size), "tar"),
    "tar: scans of 16 returns": (
        _tar_read,
        lambda size: _archive(500, _kitti(256), size),
        "tar",
    ),
    "tar: scans of 100 returns": (
        _tar_read,
        lambda size: _archive(500, _kitti(1600), size),
        "tar",
    ),
    "velodyne: fragments of 256 bytes": (
        _scan("velodyne"),
        lambda size: _captured(_fragments(65_000, step=256), size),
        "velodyne",
    ),
    "velodyne: packets of 240 bytes": (
        _scan("velodyne"),
        lambda size: _captured(udp(bytes(200), 1), size),
        "velodyne",
    ),
    "velodyne: empty packets": (
        _scan("velodyne"),
        lambda size: _captured([b""], size),
        "velodyne",
    ),
}
TWINS: dict[str, tuple[Read, Make]] = {
    "tar": (_tar_read, lambda size: _archive(4, _TEXT_SCAN, size, "csv")),
    "velodyne": (
        _scan("velodyne"),
        lambda size: _captured([f for p in hdl32(turns=3) for f in udp(p, 2368)], size),
    ),
}
"""Well-formed ones, whose CPU a byte is what archives are held against: scans as text, a turn."""


def _main(kind: str, name: str, size: int) -> None:
    known: dict[str, Any] = {"single": SINGLE, "archive": ARCHIVES, "twin": TWINS}
    read, make = known[kind][name][:2]
    body = make(size)

    def attempt() -> str:
        try:
            return type(read(body)).__name__
        except TensorMapError as error:
            return f"{type(error).__name__}: {error}"[:120]

    costs = cost_of(attempt)
    costs["mb"] += len(body) // 2**20
    json.dump({"bytes": len(body), **costs}, sys.stdout)


if __name__ == "__main__":
    _main(sys.argv[1], sys.argv[2], int(sys.argv[3]))
