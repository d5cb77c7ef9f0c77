"""Others' answers while eight clients post the largest bodies that the service accepts.

    python -m benchmarks.large_bodies [SECONDS]

Each client has a key of its own and repeats one kind of body: scans of 64 MiB to localize, 4 MiB of
JSON, or archives of 64 MiB. They are a process of their own. Meanwhile another key's fixes by a
signature, one after another on a connection, and `/livez` on new connections are timed.
"""

import http.client
import io
import math
import os
import sys
import tarfile
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing import get_context

from benchmarks.http_answers import ADMIN, KITTI, PACKED, import_map, key_of
from benchmarks.http_load import Connection, request, server
from benchmarks.queried_map import FULL_VIEWS, large_scan, queried_map
from benchmarks.results import Row, show

CLIENTS, BAR_MS = 8, 100.0
SECONDS, FEWEST = 20.0, 200
_MAP = "/v1/maps/full"
_LARGEST, _LARGEST_JSON = 64 * 2**20, 4 * 2**20
_JSON, _TAR = "application/json", "application/x-tar"
_SCANS = "/drives/d{client}/scans?format=kitti"


def measure(seconds: float = SECONDS) -> list[Row]:
    """Return the 99th percentiles, with each kind of body and without any."""
    queried = queried_map(FULL_VIEWS)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        serve = ["-m", "app.cli", "serve", "--port", "0", "--data", folder]
        with server(serve, TENSORMAP_ADMIN_KEY=ADMIN) as (_, port):
            import_map(port, "full", queried.path)
            headers = {"Authorization": f"Bearer {key_of(port)}", "Content-Type": PACKED}
            path = f"{_MAP}/localizations/signature"
            fixes = [request("POST", path, body, headers) for body in queried.bodies]
            keys = [key_of(port, "localize", "maps:read", "maps:write") for _ in range(CLIENTS)]
            for kind in ("", *_BODIES):
                load = get_context("spawn").Process(
                    target=_post_until_ended, args=(kind, port, keys), daemon=True
                )
                if kind:
                    load.start()
                    time.sleep(2.0)  # all are under way
                fix_ms, livez_ms = _timed(port, fixes, seconds)
                if kind:
                    load.kill()
                    load.join()
                rows += _rows(
                    f"with 8 clients posting {kind}" if kind else "alone", fix_ms, livez_ms
                )
    return rows


def _rows(when: str, fix_ms: list[float], livez_ms: list[float]) -> list[Row]:
    load = f"load average {os.getloadavg()[0]:.1f}"
    return [
        Row(f"p99 of {what} {when}, ms", _p99(ms), BAR_MS, _beside(ms, load), of_machine=True)
        for what, ms in (("fixes", fix_ms), ("`/livez`", livez_ms))
    ]


def _beside(ms: list[float], load: str) -> str:
    return f"median {sorted(ms)[len(ms) // 2]:.1f}, most {max(ms):.0f} of {len(ms)}; {load}"


def _p99(ms: list[float]) -> float:
    return sorted(ms)[math.ceil(0.99 * len(ms)) - 1]


def _timed(port: int, fixes: list[bytes], seconds: float) -> tuple[list[float], list[float]]:
    """Return the milliseconds of each fix and of each `/livez`, at least `FEWEST` of both."""
    livez = request("GET", "/livez")
    fix_ms: list[float] = []
    livez_ms: list[float] = []
    ends = time.perf_counter() + seconds
    kept = Connection(port)

    def fix() -> None:
        kept.ask(fixes[len(fix_ms) % len(fixes)])

    def health() -> None:
        connection = Connection(port)
        connection.ask(livez)
        connection.close()

    def repeat(once: Callable[[], None], of_it: list[float]) -> None:
        while time.perf_counter() < ends or len(of_it) < FEWEST:
            begun = time.perf_counter()
            once()
            of_it.append(1e3 * (time.perf_counter() - begun))
            time.sleep(0.02)

    threads = [
        threading.Thread(target=repeat, args=(fix, fix_ms)),
        threading.Thread(target=repeat, args=(health, livez_ms)),
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    kept.close()
    return fix_ms, livez_ms


def _scan() -> bytes:
    return (large_scan() * (_LARGEST // len(large_scan()) + 1))[: _LARGEST // 16 * 16]


def _json() -> bytes:
    keys = b",".join(b'"%07d":1' % number for number in range((_LARGEST_JSON - 2**10) // 12))
    return b"{" + keys + b"}"


def _tar() -> bytes:
    scan, written = large_scan(), io.BytesIO()
    with tarfile.open(fileobj=written, mode="w") as archive:
        for index in range(_LARGEST // (len(scan) + 2**10) - 1):
            member = tarfile.TarInfo(f"{index:06}.bin")
            member.size = len(scan)
            archive.addfile(member, io.BytesIO(scan))
    return written.getvalue()


_BODIES: dict[str, tuple[Callable[[], bytes], str, str, str]] = {
    "scans of 64 MiB": (_scan, "POST", f"{_MAP}/localizations/scan", KITTI),
    "4 MiB of JSON": (_json, "PATCH", _MAP, _JSON),
    "archives of 64 MiB": (_tar, "POST", _MAP + _SCANS, _TAR),
}


def _post_until_ended(kind: str, port: int, keys: list[str]) -> None:
    make, method, path, media_type = _BODIES[kind]
    body = make()

    def post(client: int) -> None:
        headers = {"Authorization": f"Bearer {keys[client]}", "Content-Type": media_type}
        while True:
            connection = http.client.HTTPConnection("127.0.0.1", port, timeout=120)
            with suppress(OSError, http.client.HTTPException):
                connection.request(method, path.format(client=client), body, headers)
                connection.getresponse().read()
            connection.close()

    threads = [threading.Thread(target=post, args=(client,)) for client in range(CLIENTS)]
    for thread in threads:
        thread.start()


if __name__ == "__main__":
    sys.exit(show(measure(*map(float, sys.argv[1:]))))
