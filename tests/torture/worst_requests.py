"""The worst requests that store poses and archives: read and stored, in a service of their own.

Run as a program, this module makes a service, lets it do one of them, and prints what that cost.
`TENSORMAP_TORTURE_CATALOG` is the URL of an empty PostgreSQL database, else the catalog is SQLite.
"""

import json
import os
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from app.drives.pose_files import CSV, KITTI, MOST_LINES, TUM
from core.scans.pose import Pose
from storage.catalog import ScanRecord
from tests.support.recording import TAR, tar
from tests.support.service import Client, running
from tests.torture.support.costs import cost_of

_DRIVE = "/v1/maps/campus/drives/monday"
_JSON = "application/json"
_MOST_JSON = 10_000
ARCHIVE_BYTES = 8 * 2**20
_NUMBERS = b"%.15f 0 0 %.15f 0 1 0 %.15f 0 0 1 %.15f\n"


def _kitti(shift_m: float = 0.0) -> bytes:
    return b"".join(
        _NUMBERS % (1.0, i / 7 + shift_m, i / 3 + shift_m, shift_m) for i in range(MOST_LINES)
    )


def _table(step: int, shift_m: float = 0.0) -> bytes:
    numbers = b"%d,%.15f,%.15f,%.15f,0,0,0,1,%.6f\n"
    rows = [numbers % (i * step, i / 7 + shift_m, i / 3, 1.5, i / 10) for i in range(MOST_LINES)]
    return b"scan,x,y,z,qx,qy,qz,qw,timestamp_s\n" + b"".join(rows[: MOST_LINES - 1])


def _tum() -> bytes:
    return b"".join(b"%.6f %.15f 1 2 0 0 0 1\n" % (i / 10, i / 7) for i in range(MOST_LINES))


def _json(step: int) -> bytes:
    rows = [
        {"scan": i * step, "pose": [i / 7, i / 3, 1.5, 0, 0, 0, 1], "timestamp_s": i / 10}
        for i in range(_MOST_JSON)
    ]
    return json.dumps({"poses": rows}).encode()


def _put(client: Client, body: bytes, kind: str) -> str:
    response = client.put(
        f"{_DRIVE}/poses", content=body, headers={"Content-Type": kind}, params={"partial": "true"}
    )
    return str(response.status_code) if response.is_success else str(response.json()["type"])


def _stored(step: int, count: int) -> Callable[[Client], None]:
    """Return what lets a drive have scans: rows alone, poses do not look at their returns."""

    def store(client: Client) -> None:
        scans = client.service.store.catalog.scans
        target = scans.target("campus", "monday", ())
        pose = Pose(0.1, 0.2, 0.3)
        scans.add(
            target,
            [
                ScanRecord(i * step, "one.h5", i, "a" * 64, 100, 0, i / 10 + 0.01, pose)
                for i in range(count)
            ],
        )

    return store


def _sent(body: Callable[[], bytes], kind: str) -> Callable[[Client], None]:
    def put(client: Client) -> None:
        assert _put(client, body(), kind) == "200"

    return put


def _nothing(_: Client) -> None:
    """Leave the service as it is."""


REQUESTS: dict[str, tuple[Callable[[Client], None], Callable[[], bytes], str]] = {
    "KITTI, of scans to come": (_nothing, _kitti, KITTI),
    "KITTI, others wait already": (_sent(lambda: _kitti(1.0), KITTI), _kitti, KITTI),
    "TUM, of scans to come": (_nothing, _tum, TUM),
    "CSV, every tenth scan": (_nothing, lambda: _table(10), CSV),
    "CSV, every tenth scan, others wait already": (
        _sent(lambda: _table(10, 1.0), CSV),
        lambda: _table(10),
        CSV,
    ),
    "CSV, all scans are stored": (_stored(1, MOST_LINES), lambda: _table(1), CSV),
    "CSV, every tenth scan, which is stored": (_stored(10, MOST_LINES), lambda: _table(10), CSV),
    "CSV, every second scan is stored": (_stored(2, MOST_LINES), lambda: _table(1), CSV),
    "KITTI, the last line is wrong": (_nothing, lambda: _kitti()[:-20], KITTI),
    "JSON, all scans are stored": (_stored(1, _MOST_JSON), lambda: _json(1), _JSON),
    "JSON, every tenth scan, which is stored": (_stored(10, _MOST_JSON), lambda: _json(10), _JSON),
}
"""By name: what the service has before, the body, and its type."""
REFUSED = {"KITTI, the last line is wrong": "/problems/invalid-pose"}
"""The outcome of those that are not stored, by name; of all others it is 200."""


def _members(content: bytes, name: str = "{}.bin") -> Callable[[], bytes]:
    """Return what makes an archive of many files of this content."""
    count = ARCHIVE_BYTES // (512 + -(-len(content) // 512) * 512)
    return lambda: tar([(name.format(index), content) for index in range(count)])


def _scan(returns: int) -> bytes:
    points = np.random.default_rng(0).normal(scale=20.0, size=(returns, 4))
    points[:, 3] = np.abs(points[:, 3])  # no reflectance is negative
    return points.astype("<f4").tobytes()


def _others_of_an_index() -> bytes:
    scans = (
        _scan(100)[:-4] + index.to_bytes(4, "little") for index in range(ARCHIVE_BYTES // 2560)
    )
    other = (scan[:8] + scan[-4:-2] + scan[10:] for scan in scans)
    return tar([("7.bin", scan) for scan in other])


def _one_in_the_way() -> bytes:
    scan = _scan(100)
    other = scan[16:] + scan[:16]
    return tar(
        [
            (f"{index if index % 200 else 0}.bin", scan if index % 200 or not index else other)
            for index in range(ARCHIVE_BYTES // 2560)
        ]
    )


ARCHIVES: dict[str, tuple[Callable[[], bytes], str, str]] = {
    "scans of 60,000 returns": (_members(_scan(60_000)), "", "8 stored, 0 set aside"),
    "scans of 5,000 returns": (_members(_scan(5_000)), "", "103 stored, 0 set aside"),
    "scans of 100 returns": (_members(_scan(100)), "", "3276 stored, 0 set aside"),
    "of 99 returns": (_members(_scan(99)), "scans of 100 returns", "/problems/nothing-stored"),
    "half a return too many": (
        _members(_scan(100)[:-8]),
        "scans of 100 returns",
        "/problems/nothing-stored",
    ),
    "names that are no index": (
        _members(_scan(100), "a{}.bin"),
        "scans of 100 returns",
        "/problems/nothing-stored",
    ),
    "suffixes that are not known": (
        _members(_scan(100), "{}.xyz"),
        "scans of 100 returns",
        "/problems/nothing-stored",
    ),
    "broken PCD": (
        _members(b"VERSION .7\nFIELDS x y z\n" * 64, "{}.pcd"),
        "scans of 100 returns",
        "/problems/nothing-stored",
    ),
    "broken PLY": (
        _members(b"ply\nformat ascii 1.0\n" * 80, "{}.ply"),
        "scans of 100 returns",
        "/problems/nothing-stored",
    ),
    "broken LAS": (
        _members(b"LASF" + _scan(99), "{}.las"),
        "scans of 100 returns",
        "/problems/nothing-stored",
    ),
    "broken NPY": (
        _members(b"\x93NUMPY\x01\0" + _scan(99), "{}.npy"),
        "scans of 100 returns",
        "/problems/nothing-stored",
    ),
    "CSV without numbers": (
        _members(b"x,y,z\na,b,c\n" * 120, "{}.csv"),
        "scans of 100 returns",
        "/problems/nothing-stored",
    ),
    "the same scan again and again": (
        _members(_scan(100), "7.bin"),
        "scans of 100 returns",
        "1 stored, 0 set aside",
    ),
    "other scans of the same index": (
        _others_of_an_index,
        "scans of 100 returns",
        "1 stored, 3275 set aside",
    ),
    "one of a group is another scan": (
        _one_in_the_way,
        "scans of 100 returns",
        "3260 stored, 16 set aside",
    ),
}
"""By name: what makes an archive, the well-formed one of files of its size ("" if it is one), and
what comes of it."""


def _post(client: Client, body: bytes) -> str:
    plain = body[:100].rstrip(b"\0").endswith(b".bin")
    params = {"format": "kitti"} if plain else {}
    response = client.post(f"{_DRIVE}/scans", content=body, headers=TAR, params=params)
    if not response.is_success:
        return str(response.json()["type"])
    answer = response.json()
    return f"{answer['scans_stored']} stored, {answer['files_set_aside']} set aside"


def _main(name: str) -> None:
    before: Callable[[Client], None]
    send: Callable[[Client, bytes], str]
    if name in ARCHIVES:
        make_archive, _, _ = ARCHIVES[name]
        before, make, send = _nothing, make_archive, _post
    else:
        before, make, kind = REQUESTS[name]
        send = partial(_put, kind=kind)
    settings: dict[str, Any] = {}
    if url := os.environ.get("TENSORMAP_TORTURE_CATALOG"):
        settings["catalog_url"] = url
    with (
        tempfile.TemporaryDirectory() as folder,
        running(Path(folder) / "data", **settings) as client,
    ):
        client.post("/v1/maps", json={"map": "campus"})
        before(client)
        body = make()
        costs = cost_of(lambda: send(client, body))
        json.dump({"bytes": len(body), **costs}, sys.stdout)


if __name__ == "__main__":
    _main(sys.argv[1])
