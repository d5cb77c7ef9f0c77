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
from collections.abc import Callable, Iterator, MutableSequence, Sequence
from contextlib import closing, contextmanager, suppress
from functools import partial
from multiprocessing import get_context
from multiprocessing.synchronize import Semaphore

from benchmarks.http_answers import ADMIN, KITTI, PACKED, import_map, key_of
from benchmarks.http_load import Connection, NotAnswered, in_threads, request, server
from benchmarks.queried_map import FULL_VIEWS, large_scan, queried_map
from benchmarks.results import Row, show

CLIENTS, BAR_MS = 8, 100.0
SECONDS, FEWEST = 20.0, 200
_STATUSES, _BEGIN_S = 600, 300.0
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
            rows += _rows("alone", *_timed(port, fixes, seconds))
            for kind in _BODIES:
                with _posting(kind, port, keys) as answers:
                    fix_ms, livez_ms = _timed(port, fixes, seconds)
                rows += _rows(
                    f"with 8 clients posting {kind}",
                    fix_ms,
                    livez_ms,
                    f"{_answered(kind, answers)}; ",
                )
    return rows


def _rows(when: str, fix_ms: list[float], livez_ms: list[float], load: str = "") -> list[Row]:
    load += f"load average {os.getloadavg()[0]:.1f}"
    return [
        Row(f"p99 of {what} {when}, ms", _p99(ms), BAR_MS, _beside(ms, load), of_machine=True)
        for what, ms in (("fixes", fix_ms), ("`/livez`", livez_ms))
    ]


def _beside(ms: list[float], load: str) -> str:
    return f"median {sorted(ms)[len(ms) // 2]:.1f}, most {max(ms):.0f} of {len(ms)}; {load}"


def _p99(ms: list[float]) -> float:
    if len(ms) < FEWEST:
        raise NotAnswered(f"{len(ms)} answers have no p99, which takes {FEWEST}")
    return sorted(ms)[math.ceil(0.99 * len(ms)) - 1]


def _timed(port: int, fixes: list[bytes], seconds: float) -> tuple[list[float], list[float]]:
    """Return the milliseconds of each fix and of each `/livez`, at least `FEWEST` of both."""
    livez = request("GET", "/livez")
    fix_ms: list[float] = []
    livez_ms: list[float] = []
    ends = time.perf_counter() + seconds

    def fix(kept: Connection) -> None:
        kept.ask(fixes[len(fix_ms) % len(fixes)])

    def health() -> None:
        with closing(Connection(port)) as connection:
            connection.ask(livez)

    def repeat(once: Callable[[], None], of_it: list[float]) -> None:
        while time.perf_counter() < ends or len(of_it) < FEWEST:
            begun = time.perf_counter()
            once()
            of_it.append(1e3 * (time.perf_counter() - begun))
            time.sleep(0.02)

    with closing(Connection(port)) as kept:
        in_threads([partial(repeat, partial(fix, kept), fix_ms), partial(repeat, health, livez_ms)])
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


_BODIES: dict[str, tuple[Callable[[], bytes], str, str, str, int]] = {
    "scans of 64 MiB": (_scan, "POST", f"{_MAP}/localizations/scan", KITTI, 200),
    "4 MiB of JSON": (_json, "PATCH", _MAP, _JSON, 422),
    "archives of 64 MiB": (_tar, "POST", _MAP + _SCANS, _TAR, 200),
}
"""By name: what makes a body, how and where it is posted, and how it is answered."""


@contextmanager
def _posting(kind: str, port: int, keys: list[str]) -> Iterator[Sequence[int]]:
    """Let all clients post until the block ends; yield how often each status was answered."""
    spawn = get_context("spawn")
    answers, begun = spawn.RawArray("q", _STATUSES), spawn.Semaphore(0)
    load = spawn.Process(
        target=_post_until_ended, args=(kind, port, keys, answers, begun), daemon=True
    )
    load.start()
    try:
        for _ in keys:
            if not begun.acquire(timeout=_BEGIN_S):
                raise NotAnswered(f"not all clients post {kind}")
        yield answers
    finally:
        load.kill()
        load.join()


def _answered(kind: str, answers: Sequence[int]) -> str:
    """Return how many bodies were answered.

    Raises:
        NotAnswered: If none was, or one with another status than such a body has.
    """
    wanted = _BODIES[kind][-1]
    counts = {status: count for status, count in enumerate(answers) if count}
    if set(counts) != {wanted}:
        raise NotAnswered(f"{kind} were answered with {counts}, 0 is no answer; not all {wanted}")
    return f"{counts[wanted]} bodies answered with {wanted}"


def _post_until_ended(
    kind: str, port: int, keys: list[str], answers: MutableSequence[int], begun: Semaphore
) -> None:
    make, method, path, media_type, _ = _BODIES[kind]
    body = make()
    counting = threading.Lock()

    def post(client: int) -> None:
        first = True
        headers = {"Authorization": f"Bearer {keys[client]}", "Content-Type": media_type}
        while True:
            connection = http.client.HTTPConnection("127.0.0.1", port, timeout=120)
            status = 0
            if first:
                begun.release()
                first = False
            with suppress(OSError, http.client.HTTPException):
                connection.request(method, path.format(client=client), body, headers)
                answer = connection.getresponse()
                answer.read()
                status = answer.status
            connection.close()
            with counting:
                answers[status] += 1

    threads = [threading.Thread(target=post, args=(client,)) for client in range(CLIENTS)]
    for thread in threads:
        thread.start()


if __name__ == "__main__":
    sys.exit(show(measure(*map(float, sys.argv[1:]))))
