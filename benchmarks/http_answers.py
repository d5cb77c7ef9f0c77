"""Answers over HTTP: CPU time of the service for each, beside what it cannot be less than.

    python -m benchmarks.http_answers [QUICK]

The service, and beside it a server that only reads bodies (`benchmarks.http_floor`), are processes
of their own; load comes from this one. `match` is what core needs for the answer, in this process,
and `search` the part of it that finds the nearest scan. `full` are queries to a map of full views,
5 x 5, `any` to one of the present default. With an argument each row takes three rounds.
"""

import hashlib
import json
import os
import resource
import sqlite3
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits
from websockets.sync.client import connect

from benchmarks.http_load import (
    Connection,
    cpu_ms_each,
    cpu_s,
    most_per_s,
    once,
    request,
    rss_mb,
    server,
    wall_ms,
)
from benchmarks.queried_map import (
    ANY_VIEWS,
    FULL_VIEWS,
    QUERIES,
    SCANS,
    QueriedMap,
    large_scan,
    queried_map,
)
from benchmarks.results import Row, show
from core.encodings.signature import Signature, unpack_signatures
from core.tracking.track import Observation, Track, Tracker
from storage.formats.scans.registry import read_scan

ROUNDS, EACH = 8, 40  # of each row, and requests in one
FIRST = 20  # observations after which a vehicle on its way is localized
FIXES_PER_S_BAR, CLIENTS = 300, 8
READY_S_BAR, READY_MB_BAR, HELP_S_BAR = 1.5, 130, 0.5
KITTI = "application/vnd.tensormap.kitti"
PACKED = "application/vnd.tensormap.signature"
MANY = "application/vnd.tensormap.signatures"
ADMIN = "benchmark-administrator"
_ADMIN = {"Authorization": f"Bearer {ADMIN}"}
_JSON = {"Content-Type": "application/json"}


def measure(*, quick: bool = False) -> list[Row]:
    """Return the rows of both maps, and of the start."""
    threadpool_limits(limits=1)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    maps = {"full": queried_map(FULL_VIEWS), "any": queried_map(ANY_VIEWS)}
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        serve = ["-m", "app.cli", "serve", "--port", "0", "--data", f"{folder}/data"]
        with server(serve, TENSORMAP_ADMIN_KEY=ADMIN):
            pass  # the first start makes the catalog, and may compile our modules
        with (
            server(["-m", "benchmarks.http_floor"]) as floor,
            server(serve, TENSORMAP_ADMIN_KEY=ADMIN) as service,
        ):
            ready = cpu_s(service[0]), rss_mb(service[0])
            rounds = 3 if quick else ROUNDS
            scan, key = large_scan(), key_of(service[1])
            for name, queried in maps.items():
                import_map(service[1], name, queried.path)
                measured = _Measured(service, floor, name, key, queried, rounds)
                rows += [*measured.fix(), *measured.track(), measured.stream(), measured.batch()]
                rows += [measured.scan(scan), measured.rate(2.0 if quick else 10.0)]
            rows += [_put(service, scan, Path(folder), rounds), _map(service, rounds)]
            answering_mb = rss_mb(service[0])
    beside = f"after all of the above, two maps of {SCANS} scans loaded: {answering_mb:.0f}"
    rows += [
        Row("`serve` ready, CPU s", ready[0], READY_S_BAR, of_machine=True),
        Row("`serve` ready, MB", ready[1], READY_MB_BAR, beside, of_machine=True),
        Row("`tensormap --help`, CPU s", _help_s(), HELP_S_BAR, of_machine=True),
    ]
    return rows


class _Measured:
    """The rows of one map."""

    def __init__(
        self,
        service: tuple[int, int],
        floor: tuple[int, int],
        name: str,
        key: str,
        queried: QueriedMap,
        rounds: int,
    ) -> None:
        self._service, self._floor, self._rounds = service, floor, rounds
        self._name, self._path = name, f"/v1/maps/{name}"
        self._headers = {"Authorization": f"Bearer {key}"}
        self._localizer, self._bodies, self._way = queried.localizer, queried.bodies, queried.way
        self._tracker = Tracker(self._localizer)
        self._fixes = self._requests("localizations/signature")
        self._signatures = [unpack_signatures(body) for body in self._bodies]

    def fix(self) -> list[Row]:
        """Return the rows of a fix by a signature, answered as JSON and packed."""
        packed = self._requests("localizations/signature", Accept="application/vnd.tensormap.fix")
        rows = []
        for form, requests in (("JSON", self._fixes), ("packed", packed)):
            ms, floor, m, search = self._in_turn(
                self._asked(requests), self._floored(), self._matched(), self._searched()
            )
            size = len(once(self._service[1], requests[0]))
            beside = f"floor {floor:.2f}, match {m:.2f}, of which search {search:.2f}; {size} bytes"
            what = f"fix by {len(self._bodies[0])} bytes, {form}, CPU ms"
            rows.append(self._row(what, ms, 2 * floor + 1.5 * m, beside))
        return rows

    def track(self) -> list[Row]:
        """Return the rows of observations over HTTP: of a vehicle on its way, and of a lost one."""
        lost = self._requests(f"tracks/{self._new_track()}/observations")
        found = []
        for what, asked, own in (
            ("observation of a track", self._asked_on_its_way, self._tracked(self._way)),
            ("observation of a lost vehicle", self._asked(lost), self._tracked(self._bodies)),
        ):
            ms, floor, m = self._in_turn(asked, self._floored(), own)
            beside = f"floor {floor:.2f}, match {m:.2f}"
            found.append(self._row(f"{what}, CPU ms", ms, 2 * floor + 1.5 * m, beside))
        return found

    def stream(self) -> Row:
        """Return the row of a vehicle's observation over WebSocket, on its way."""
        path = f"{self._path}/tracks"
        ms, floor, m = self._in_turn(
            lambda: self._streamed(
                self._service, f"{path}/{self._new_track()}/stream", self._headers
            ),
            partial(self._streamed, self._floor, "/echo", {}),
            self._tracked(self._way),
        )
        beside = f"echo {floor:.2f}, match {m:.2f}"
        return self._row("observation over WebSocket, CPU ms", ms, floor + 1.5 * m, beside)

    def batch(self) -> Row:
        """Return the row of one of many signatures in one request."""
        body = b"".join(len(b).to_bytes(2, "little") + b for b in self._bodies)
        fields = {**self._headers, "Content-Type": MANY}
        one = request("POST", f"{self._path}/localizations/batch", body, fields)
        ms, m = self._in_turn(self._asked([one], 2), self._matched())
        what = f"each of a batch of {QUERIES}, CPU ms"
        return self._row(what, ms / QUERIES, 1.3 * m, f"match {m:.2f}")

    def scan(self, scan: bytes) -> Row:
        """Return the row of a fix by a scan."""
        headers = {**self._headers, "Content-Type": KITTI}
        requests = [request("POST", f"{self._path}/localizations/scan", scan, headers)]
        points = read_scan(scan, media_type=KITTI, min_returns=100)
        ms, floor, m, parse_ms = self._in_turn(
            self._asked(requests),
            self._floored([scan]),
            partial(_own_ms, [lambda: self._localizer.localize_scan(points)] * 5),
            partial(_own_ms, [lambda: read_scan(scan, media_type=KITTI, min_returns=100)] * 5),
        )
        beside = f"floor {floor:.2f}, projection and match {m:.2f}; parsing {parse_ms:.2f}"
        what = f"fix by a scan of {len(points)} returns, CPU ms"
        return self._row(what, ms, floor + 2 * m, beside)

    def rate(self, seconds: float) -> Row:
        """Return the row of fixes to several clients; others' load does not count."""
        every = os.sched_getaffinity(0)
        service, load = min(every), max(every)
        _pin(self._service[0], {service})
        os.sched_setaffinity(0, {load})
        begun = cpu_s(self._service[0])
        most = most_per_s(self._service[1], self._fixes, CLIENTS, seconds)
        spent = cpu_s(self._service[0]) - begun
        os.sched_setaffinity(0, every)
        _pin(self._service[0], every)
        beside = f"{CLIENTS} clients, load on the other core; {most:.0f} each second that passed"
        bar = FIXES_PER_S_BAR
        what = "fixes a CPU second, service on one core"
        return self._row(what, most * seconds / spent, bar, beside, at_least=True, of_machine=True)

    def _row(self, what: str, measured: float, bar: float, beside: str, **about: bool) -> Row:
        return Row(f"{self._name}: {what}", measured, bar, beside, **about)

    def _requests(self, path: str, bodies: Sequence[bytes] = (), **headers: str) -> list[bytes]:
        fields = {**self._headers, "Content-Type": PACKED, **headers}
        path = f"{self._path}/{path}"
        return [request("POST", path, body, fields) for body in bodies or self._bodies]

    def _in_turn(self, *measures: Callable[[], float]) -> list[float]:
        """Return the means of some measures that are taken in turn: load of others is of all."""
        rounds = [[measure() for measure in measures] for _ in range(self._rounds)]
        return [statistics.mean(of_one) for of_one in zip(*rounds, strict=True)]

    def _asked(self, requests: Sequence[bytes], count: int = EACH) -> Callable[[], float]:
        return partial(cpu_ms_each, *self._service, requests, count)

    def _floored(self, bodies: Sequence[bytes] = ()) -> Callable[[], float]:
        headers = {**self._headers, "Content-Type": PACKED}
        requests = [request("POST", "/floor", body, headers) for body in bodies or self._bodies]
        return partial(cpu_ms_each, *self._floor, requests, EACH if bodies else 10 * EACH)

    def _matched(self) -> Callable[[], float]:
        def localize(body: bytes) -> None:
            self._localizer.localize_signatures(unpack_signatures(body))

        return partial(_own_ms, [partial(localize, body) for body in self._bodies])

    def _searched(self) -> Callable[[], float]:
        def search(signatures: Sequence[Signature]) -> None:
            self._localizer.map.model.search(signatures).nearest(1)

        return partial(_own_ms, [partial(search, one) for one in self._signatures])

    def _tracked(self, bodies: Sequence[bytes]) -> Callable[[], float]:
        def own() -> float:
            track = Track(self._tracker)

            def observe(body: bytes) -> None:
                track.observe(Observation(unpack_signatures(body)))

            for body in bodies[:FIRST]:
                observe(body)
            return _own_ms([partial(observe, body) for body in bodies[FIRST:]])

        return own

    def _asked_on_its_way(self) -> float:
        pid, port = self._service
        requests = self._requests(f"tracks/{self._new_track()}/observations", self._way)
        connection = Connection(port)
        for number, one in enumerate(requests):
            if number == FIRST:
                begun = cpu_s(pid)
            connection.ask(one)
        spent = cpu_s(pid) - begun
        connection.close()
        return 1e3 * spent / (len(requests) - FIRST)

    def _new_track(self) -> str:
        made = once(
            self._service[1], request("POST", f"{self._path}/tracks", headers=self._headers)
        )
        return str(json.loads(made)["track"])

    def _streamed(self, of: tuple[int, int], path: str, headers: dict[str, str]) -> float:
        pid, port = of
        with connect(f"ws://127.0.0.1:{port}{path}", additional_headers=headers) as stream:
            for number, body in enumerate(self._way):
                if number == FIRST:
                    begun = cpu_s(pid)
                stream.send(body)
                stream.recv()
            return 1e3 * (cpu_s(pid) - begun) / (len(self._way) - FIRST)


def key_of(port: int, *scopes: str) -> str:
    """Make a key and return it; a vehicle's without scopes."""
    wanted = json.dumps({"name": "a key", "scopes": scopes or ["localize"]})
    made = once(port, request("POST", "/v1/keys", wanted.encode(), {**_ADMIN, **_JSON}))
    return str(json.loads(made)["secret"])


def import_map(port: int, name: str, path: Path) -> None:
    """Make a map of a file."""
    body = json.dumps({"map": name}).encode()
    once(port, request("POST", "/v1/maps", body, {**_ADMIN, **_JSON}))
    imported = {**_ADMIN, "Content-Type": "application/vnd.tensormap.map+hdf5"}
    once(port, request("POST", f"/v1/maps/{name}/revisions", path.read_bytes(), imported))


def _put(service: tuple[int, int], scan: bytes, folder: Path, rounds: int) -> Row:
    headers = {**_ADMIN, "Content-Type": KITTI}
    path = f"/v1/maps/full/drives/d{time.time_ns()}/scans"
    cpu_ms, ours, plain, plain_cpu = [], [], [], []
    for number in range(rounds):
        some = range(number * EACH // 2, (number + 1) * EACH // 2)
        begun = cpu_s(service[0])
        ours += wall_ms(service[1], [request("PUT", f"{path}/{i}", scan, headers) for i in some])
        cpu_ms.append(1e3 * (cpu_s(service[0]) - begun) / len(some))
        begun = time.process_time()
        plain += _plain_put_ms(scan, folder, some)
        plain_cpu.append(1e3 * (time.process_time() - begun) / len(some))
    beside = (
        f"plain sequence {statistics.median(plain):.1f} (CPU {statistics.mean(cpu_ms):.1f},"
        f" plain {statistics.mean(plain_cpu):.1f})"
    )
    bar = 2 * statistics.median(plain)
    return Row("`PUT` of that scan, elapsed ms", statistics.median(ours), bar, beside)


def _map(service: tuple[int, int], rounds: int) -> Row:
    get, live = request("GET", "/v1/maps/full", headers=_ADMIN), request("GET", "/livez")
    times = [
        [cpu_ms_each(*service, [asked], 10 * EACH) for asked in (get, live)] for _ in range(rounds)
    ]
    ms, live_ms = map(statistics.mean, zip(*times, strict=True))
    return Row("`GET` of a map, CPU ms", ms, 2 * live_ms, f"`/livez` {live_ms:.2f}")


def _own_ms(functions: Sequence[Callable[[], object]]) -> float:
    """Return the CPU milliseconds of one of these in this process."""
    functions[0]()  # not counted
    begun = time.process_time()
    for function in functions:
        function()
    return 1e3 * (time.process_time() - begun) / len(functions)


def _plain_put_ms(scan: bytes, folder: Path, numbers: Sequence[int]) -> list[float]:
    """Return the elapsed milliseconds of what storing each scan takes in plain Python."""
    catalog = sqlite3.connect(folder / "plain.sqlite3", isolation_level=None)
    catalog.execute("PRAGMA journal_mode = WAL")
    catalog.execute("PRAGMA synchronous = FULL")
    catalog.execute("CREATE TABLE IF NOT EXISTS scans (number INTEGER PRIMARY KEY, digest TEXT)")
    directory = os.open(folder, os.O_RDONLY)
    times = []
    for number in numbers:
        begun = time.perf_counter()
        points = np.frombuffer(scan, "<f4").reshape(-1, 4)[:, :3]
        kept = np.ascontiguousarray(points[np.isfinite(points).all(axis=1)]).tobytes()
        digest = hashlib.sha256(kept).hexdigest()
        path = folder / f"{number}.part"
        with path.open("wb") as file:
            file.write(kept)
            file.flush()
            os.fsync(file.fileno())
        if hashlib.sha256(path.read_bytes()).hexdigest() != digest:
            raise SystemExit("the disk returns something else")
        path.rename(folder / f"{number}.bin")
        os.fsync(directory)
        catalog.execute("INSERT INTO scans VALUES (?, ?)", (number, digest))
        times.append(1e3 * (time.perf_counter() - begun))
    os.close(directory)
    catalog.close()
    return times


def _help_s() -> float:
    """Return the CPU seconds of `tensormap --help`."""
    spent = []
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, "-m", "app.cli", "--help"], check=True, capture_output=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return statistics.median(spent)


def _pin(pid: int, cores: set[int]) -> None:
    """Let all threads of a process run on these cores only."""
    for thread in Path(f"/proc/{pid}/task").iterdir():
        os.sched_setaffinity(int(thread.name), cores)


if __name__ == "__main__":
    sys.exit(show(measure(quick=len(sys.argv) > 1)))
