"""Whole inputs of every reader, made here, and how they are damaged, by a seed that is printed."""

import gzip
import io
import json
import os
import random
import struct
import tarfile
import time
from collections.abc import Callable

import numpy as np
import zstandard
from pypcd4.pypcd4 import Encoding

from storage.formats.scans.helipr import HeliprFormat
from storage.formats.scans.registry import FORMAT_NAMES, SCAN_FORMATS
from tests.support import scan_files as scans
from tests.support.captures import hdl32, ouster, ouster_body, ouster_metadata, pcap, udp

SEED = int(os.environ.get("TENSORMAP_TORTURE_SEED") or time.time_ns() % 1_000_000)
"""The seed of this run."""
os.environ["TENSORMAP_TORTURE_SEED"] = str(SEED)
INPUTS = int(os.environ.get("TENSORMAP_TORTURE_INPUTS") or 500)
"""How many inputs each reader gets."""

CLOUD = np.random.default_rng(0).normal(scale=20.0, size=(120, 3)).astype(np.float32)

_WORDS = [
    b"nan", b"inf", b"-1", b"0", b"1e999", b"1" * 400, b"#", b"\0", b"\n" * 50, b",,,,",
    b"DATA ascii\n", b"x y z", b"\xff" * 8, b"\x7f\xff\xff\xff", b"\x81\x00" * 30,
    b"path=", b"[" * 200, b"end_header\n",
]  # fmt: skip


def _frames(payloads: list[bytes], fragment_bytes: int | None) -> list[bytes]:
    return [
        frame
        for number, payload in enumerate(payloads)
        for frame in udp(payload, 2368, fragment_bytes=fragment_bytes, number=number % 65536)
    ]


def _nclt(points: np.ndarray) -> bytes:
    records = np.zeros(len(points), [("xyz", "<u2", 3), ("i", "u1"), ("laser", "u1")])
    records["xyz"] = ((points + 100.0) / 0.005).clip(0, 65535)
    return records.tobytes()


def _helipr(kind: HeliprFormat) -> bytes:
    records = np.zeros(len(CLOUD), [("xyz", "<f4", 3), *kind.besides])
    records["xyz"] = CLOUD
    return records.tobytes()


def _tar(style: int) -> bytes:
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode="w", format=style) as archive:
        long = "long" * (10 if style == tarfile.USTAR_FORMAT else 40)
        for name in ("0.npy", f"folder/{long}/1.pcd", "2.csv", "notes.txt"):
            body = scans.npy(CLOUD[:20])
            info = tarfile.TarInfo(name)
            info.size = len(body)
            archive.addfile(info, io.BytesIO(body))
    return file.getvalue()


def _poses(kind: str) -> bytes:
    rows = [f"{i}.5 {i} 2 3 0 0 0 1" for i in range(30)]
    if kind == "kitti":
        rows = [f"1 0 0 {i} 0 1 0 5 0 0 1 6" for i in range(30)] + ["nan " * 12]
    if kind == "csv":
        head = "scan,x,y,z,qx,qy,qz,qw,timestamp_s"
        rows = [head, *(f"{i},1,2,3,0,0,0,1,{'' if i % 2 else i}" for i in range(30))]
    return "\n".join(rows).encode()


def samples() -> dict[str, list[bytes]]:
    """Return whole inputs by the name of the reader."""
    turn, frame = hdl32(turns=1.2), ouster()
    texts = np.linspace(1, 60, 60, dtype=np.float32).reshape(-1, 3)
    csv = scans.csv(texts)
    whole = {
        "kitti": [scans.kitti(CLOUD)],
        "npy": [scans.npy(CLOUD), scans.npy(np.asfortranarray(CLOUD.astype("f8")))],
        "pcd": [scans.pcd(CLOUD, encoding) for encoding in Encoding],
        "ply": [scans.ply(CLOUD, "<"), scans.ply(CLOUD, ">"), scans.ply_ascii(texts)],
        "csv": [csv, csv.replace(b",", b" "), csv.replace(b"x,y,z\n", b"")],
        "las": [scans.las(CLOUD)],
        "nuscenes": [scans.nuscenes(CLOUD)],
        "nclt": [_nclt(CLOUD)],
        **{
            kind.media_type.rpartition(".")[2]: [_helipr(kind)]
            for kind in SCAN_FORMATS
            if isinstance(kind, HeliprFormat)
        },
        "ford": [scans.ford(CLOUD, compress=False), scans.ford(CLOUD, compress=True)],
        "velodyne": [pcap(_frames(turn, None)), pcap(_frames(turn, 400), order=">")],
        "ouster": [
            ouster_body(ouster_metadata(), _frames(frame, None)),
            ouster_body(ouster_metadata(), _frames(frame, 1480)),
        ],
    }
    assert set(whole) == set(FORMAT_NAMES), "a format without inputs"
    return {
        **whole,
        "poses.kitti": [_poses("kitti")],
        "poses.tum": [_poses("tum")],
        "poses.csv": [_poses("csv")],
        "tar": [_tar(tarfile.USTAR_FORMAT), _tar(tarfile.GNU_FORMAT), _tar(tarfile.PAX_FORMAT)],
        "gzip": [gzip.compress(csv * 20), gzip.compress(csv) + gzip.compress(b"") * 3],
        "zstd": [zstandard.compress(csv * 20), zstandard.compress(csv) + zstandard.compress(b"")],
        "json": [
            json.dumps({"poses": [{"scan": 0, "pose": [1, 2, 3, 0, 0, 0, 1]}]}).encode(),
            json.dumps({"map": "campus", "description": "a\u00e9"}).encode(),
            json.dumps({"name": "fleet", "scopes": ["localize"], "maps": ["campus"]}).encode(),
        ],
    }


def damaged(body: bytes, chance: random.Random) -> bytes:
    """Return a body with a few changes: bits, numbers, words, parts that go, come twice or move."""
    changed = bytearray(body)
    for _ in range(chance.randint(1, 6)):
        if not changed:
            break
        at = _place(chance, len(changed))
        chance.choice(_CHANGES)(changed, at, chance)
    return bytes(changed)


def _place(chance: random.Random, length: int) -> int:
    """Return a place, more often in the head than in what follows."""
    return chance.randrange(min(length, 200) if chance.random() < 0.5 else length)


def _flip(body: bytearray, at: int, chance: random.Random) -> None:
    body[at] ^= 1 << chance.randrange(8)


def _number(body: bytearray, at: int, chance: random.Random) -> None:
    number = chance.choice([0, 1, 2**16 - 1, 2**31 - 1, 2**32 - 1, chance.getrandbits(32)])
    body[at : at + 4] = struct.pack(chance.choice("<>") + "I", number)


def _word(body: bytearray, at: int, chance: random.Random) -> None:
    word = chance.choice(_WORDS)
    body[at : at + chance.choice([0, len(word)])] = word


def _cut(body: bytearray, at: int, chance: random.Random) -> None:
    del body[at : at + chance.choice([1, 4, 100, len(body)])]


def _again(body: bytearray, at: int, chance: random.Random) -> None:
    part = bytes(body[at : at + chance.choice([1, 16, 600])])
    body[at:at] = part * chance.choice([1, 2, 50])


def _noise(body: bytearray, at: int, chance: random.Random) -> None:
    part = chance.randbytes(chance.choice([1, 8, 64]))
    body[at : at + len(part)] = part


_CHANGES: list[Callable[[bytearray, int, random.Random], None]] = [
    _flip, _flip, _number, _word, _cut, _again, _noise,
]  # fmt: skip
