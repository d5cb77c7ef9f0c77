"""Answers over HTTP: CPU time of the service for each, beside what it cannot be less than.

    python -m benchmarks.http_answers [QUICK]

The service, and beside it a server that only reads bodies (`benchmarks.http_floor`), are processes
of their own; load comes from this one. `match` is what core needs for the answer, in this process,
and `search` the part of it that finds the nearest scan. With an argument each row takes
three rounds. Fails if a bar is missed.
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
from dataclasses import dataclass
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
    request,
    rss_mb,
    server,
    wall_ms,
)
from benchmarks.maps import localizer_of
from benchmarks.timing import machine
from core.encodings.signature import Signature, pack_signatures, unpack_signatures
from core.localization.localizer import Localizer
from core.parameters import MapParameters
from core.scans.scan import Scan
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from core.tracking.track import Observation, Track, Tracker
from storage.files.map_file import read_map, write_map
from storage.formats.scans.registry import read_scan

PARAMETERS = MapParameters.for_sensor(encoding="harmonic")
SCANS, QUERIES, RETURNS = 3800, 32, 60_000
ROUNDS, EACH = 8, 40  # of each row, and requests in one
FIXES_PER_S_BAR, CLIENTS = 300, 8
READY_S_BAR, READY_MB_BAR, HELP_S_BAR = 1.5, 130, 0.5
KITTI = "application/vnd.tensormap.kitti"
PACKED = "application/vnd.tensormap.signature"
MANY = "application/vnd.tensormap.signatures"
MAP = "/v1/maps/campus"
ADMIN = "benchmark-administrator"


@dataclass(frozen=True)
class Row:
    """One line of the table, in milliseconds of CPU unless its name says otherwise."""

    name: str
    measured: float
    bar: float
    beside: str
    at_least: bool = False

    @property
    def holds(self) -> bool:
        """Whether the bar is kept."""
        return self.measured >= self.bar if self.at_least else self.measured <= self.bar

    def __str__(self) -> str:
        sign, said = (">=", "yes") if self.at_least else ("<=", "yes")
        return (
            f"| {self.name} | {self.measured:.2f} | {sign} {self.bar:.2f} |"
            f" {said if self.holds else '**no**'} | {self.beside} |"
        )


def main(*, quick: bool) -> int:
    """Print the table; return how many bars were missed."""
    threadpool_limits(limits=1)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    localizer, bodies, scan = _map_and_queries()
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
            key = _set_up(service[1])
            measured = _Measured(service, floor, key, localizer, bodies, 3 if quick else ROUNDS)
            for rows_of in (
                measured.fix,
                measured.track,
                measured.stream,
                measured.batch,
                partial(measured.scan, scan),
                partial(measured.put, scan, Path(folder)),
                measured.map,
                partial(measured.rate, 2.0 if quick else 10.0),
            ):
                rows += rows_of()
        rows.append(Row("`serve` ready, s", ready[0], READY_S_BAR, ""))
        rows.append(Row("`serve` ready, MB", ready[1], READY_MB_BAR, ""))
    rows.append(Row("`tensormap --help`, s", _help_s(), HELP_S_BAR, ""))
    print(f"{machine()}; map of {SCANS} scans, CPU milliseconds for each unless named otherwise\n")
    print("| what | measured | bar | holds | beside it |\n|---|---|---|---|---|")
    for row in rows:
        print(row)
    return sum(not row.holds for row in rows)


class _Measured:
    """The rows of the table; each method returns some."""

    def __init__(
        self,
        service: tuple[int, int],
        floor: tuple[int, int],
        key: str,
        localizer: Localizer,
        bodies: Sequence[bytes],
        rounds: int,
    ) -> None:
        self._service, self._floor, self._rounds = service, floor, rounds
        self._headers = {"Authorization": f"Bearer {key}"}
        self._localizer, self._bodies = localizer, bodies
        self._fixes = self._requests("localizations/signature")
        self._signatures = [unpack_signatures(body) for body in bodies]

    def fix(self) -> list[Row]:
        shorter = self._requests("localizations/signature", Accept="application/vnd.tensormap.fix")
        rows = []
        for requests in (self._fixes, shorter):
            ms, floor, m, search = self._in_turn(
                self._asked(requests), self._floored(), self._matched(), self._searched()
            )
            size = len(self._once(requests[0]))
            beside = f"floor {floor:.2f}, match {m:.2f}, its search {search:.2f}"
            name = f"fix by {len(self._bodies[0])} bytes, answer of {size}"
            rows.append(Row(name, ms, 2 * floor + 1.5 * m, beside))
        return rows

    def track(self) -> list[Row]:
        requests = self._requests(f"tracks/{self._new_track()}/observations")
        ms, floor, m = self._in_turn(self._asked(requests), self._floored(), self._tracked())
        beside = f"floor {floor:.2f}, match {m:.2f}"
        return [Row("observation of a track", ms, 2 * floor + 1.5 * m, beside)]

    def stream(self) -> list[Row]:
        path = f"{MAP}/tracks/{self._new_track()}/stream"
        ms, floor, m = self._in_turn(
            partial(self._streamed, self._service, path, self._headers, EACH),
            partial(self._streamed, self._floor, "/echo", {}, 3 * EACH),
            self._tracked(),
        )
        beside = f"echo {floor:.2f}, match {m:.2f}"
        return [Row("the same over WebSocket", ms, floor + 1.5 * m, beside)]

    def batch(self) -> list[Row]:
        body = b"".join(len(b).to_bytes(2, "little") + b for b in self._bodies)
        fields = {**self._headers, "Content-Type": MANY}
        one = request("POST", f"{MAP}/localizations/batch", body, fields)
        ms, m = self._in_turn(self._asked([one], 2), self._matched())
        beside = f"match {m:.2f}; {QUERIES} in one"
        return [Row("each of a batch", ms / QUERIES, 1.3 * m, beside)]

    def scan(self, scan: bytes) -> list[Row]:
        headers = {**self._headers, "Content-Type": KITTI}
        requests = [request("POST", f"{MAP}/localizations/scan", scan, headers)]
        points = read_scan(scan, media_type=KITTI, min_returns=100)
        ms, floor, m, parse_ms = self._in_turn(
            self._asked(requests),
            self._floored([scan]),
            partial(_own_ms, [lambda: self._localizer.localize_scan(points)] * 5),
            partial(_own_ms, [lambda: read_scan(scan, media_type=KITTI, min_returns=100)] * 5),
        )
        beside = f"floor {floor:.2f}, projection and match {m:.2f}; parsing {parse_ms:.2f}"
        return [Row(f"fix by a scan of {len(points)} returns", ms, floor + 2 * m, beside)]

    def put(self, scan: bytes, folder: Path) -> list[Row]:
        headers = {"Authorization": f"Bearer {ADMIN}", "Content-Type": KITTI}
        count = EACH * self._rounds // 2
        path = f"{MAP}/drives/d{time.time_ns()}/scans"
        requests = [request("PUT", f"{path}/{i}", scan, headers) for i in range(count)]
        begun = cpu_s(self._service[0])
        ours = wall_ms(self._service[1], requests)
        cpu_ms = 1e3 * (cpu_s(self._service[0]) - begun) / count
        plain, plain_cpu = _plain_put_ms(scan, folder, count)
        wall = statistics.median(ours)
        beside = f"plain sequence {plain:.1f} (CPU {cpu_ms:.1f}, plain {plain_cpu:.1f})"
        return [Row("`PUT` of that scan, elapsed", wall, 2 * plain, beside)]

    def map(self) -> list[Row]:
        get = [request("GET", MAP, headers={"Authorization": f"Bearer {ADMIN}"})]
        live = [request("GET", "/livez")]
        ms, live_ms = self._in_turn(self._asked(get, 10 * EACH), self._asked(live, 10 * EACH))
        return [Row("`GET` of a map", ms, 2 * live_ms, f"`/livez` {live_ms:.2f}")]

    def rate(self, seconds: float) -> list[Row]:
        every = os.sched_getaffinity(0)
        service, load = min(every), max(every)
        _pin(self._service[0], {service})
        os.sched_setaffinity(0, {load})
        most = most_per_s(self._service[1], self._fixes, CLIENTS, seconds)
        os.sched_setaffinity(0, every)
        _pin(self._service[0], every)
        beside = f"{CLIENTS} clients, load on the other core"
        name = "fixes a second, service on one core"
        return [Row(name, most, FIXES_PER_S_BAR, beside, at_least=True)]

    def _requests(self, path: str, **headers: str) -> list[bytes]:
        fields = {**self._headers, "Content-Type": PACKED, **headers}
        return [request("POST", f"{MAP}/{path}", body, fields) for body in self._bodies]

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

    def _tracked(self) -> Callable[[], float]:
        track = Track(Tracker(self._localizer))

        def observe(body: bytes) -> None:
            track.observe(Observation(unpack_signatures(body)))

        return partial(_own_ms, [partial(observe, body) for body in self._bodies])

    def _once(self, asked: bytes) -> bytes:
        connection = Connection(self._service[1])
        answer = connection.ask(asked)
        connection.close()
        return answer

    def _new_track(self) -> str:
        made = self._once(request("POST", f"{MAP}/tracks", headers=self._headers))
        return str(json.loads(made)["track"])

    def _streamed(
        self, of: tuple[int, int], path: str, headers: dict[str, str], count: int
    ) -> float:
        pid, port = of
        with connect(f"ws://127.0.0.1:{port}{path}", additional_headers=headers) as stream:
            for number in range(count + 20):
                if number == 20:
                    begun = cpu_s(pid)
                stream.send(self._bodies[number % len(self._bodies)])
                stream.recv()
            return 1e3 * (cpu_s(pid) - begun) / count


def _map_and_queries() -> tuple[Localizer, list[bytes], bytes]:
    """Return the map, kept in a file of the temporary folder, packed queries and a scan."""
    sensor = SimulatedSensor(firings=180)
    loop_m = 1.05 * SCANS
    path = _map_path()
    drive = SimulatedDrive(seed=1, scans=SCANS, loop_m=loop_m, sensor=sensor)
    if path.exists():
        localizer = Localizer(read_map(path))
    else:
        localizer = localizer_of(drive, np.arange(SCANS), PARAMETERS, segments=5, calibrated=True)
        write_map(path, localizer.map)
    basis, query = (
        localizer.basis,
        SimulatedDrive(
            seed=1, scans=SCANS, loop_m=loop_m, sensor=sensor, noise_seed=7, lateral_offset_m=0.7
        ),
    )
    bodies = [
        pack_signatures(basis.encode(basis.image(query.scan(index))))
        for index in np.linspace(3, SCANS - 3, QUERIES).astype(int).tolist()
    ]
    full = SimulatedDrive(
        seed=1, scans=SCANS, loop_m=loop_m, sensor=SimulatedSensor(firings=1800), noise_seed=7
    )
    return localizer, bodies, _body(full.scan(5))


def _body(scan: Scan) -> bytes:
    """Return the first returns of a scan in KITTI's layout."""
    points = np.resize(scan.points_m, (RETURNS, 3))
    return bytes(np.pad(points, ((0, 0), (0, 1))).astype("<f4").tobytes())


def _map_path() -> Path:
    """Return where the map is kept, for the next run."""
    named = hashlib.sha256(repr((PARAMETERS, SCANS)).encode()).hexdigest()[:12]
    return Path(tempfile.gettempdir(), f"tensormap-benchmark-{named}.h5")


def _set_up(port: int) -> str:
    """Make the map and a vehicle's key; return the key."""
    connection = Connection(port)
    admin = {"Authorization": f"Bearer {ADMIN}"}
    as_json = {**admin, "Content-Type": "application/json"}
    connection.ask(request("POST", "/v1/maps", b'{"map": "campus"}', as_json))
    imported = {**admin, "Content-Type": "application/vnd.tensormap.map+hdf5"}
    connection.ask(request("POST", f"{MAP}/revisions", _map_path().read_bytes(), imported))
    wanted = json.dumps({"name": "vehicle", "scopes": ["localize"], "maps": ["campus"]})
    made = connection.ask(request("POST", "/v1/keys", wanted.encode(), as_json))
    connection.close()
    return str(json.loads(made)["secret"])


def _own_ms(functions: Sequence[Callable[[], object]]) -> float:
    """Return the CPU milliseconds of one of these in this process."""
    functions[0]()  # not counted
    begun = time.process_time()
    for function in functions:
        function()
    return 1e3 * (time.process_time() - begun) / len(functions)


def _plain_put_ms(scan: bytes, folder: Path, count: int) -> tuple[float, float]:
    """Return the milliseconds of what storing a scan takes in plain Python: elapsed, and CPU."""
    catalog = sqlite3.connect(folder / "plain.sqlite3", isolation_level=None)
    catalog.execute("PRAGMA journal_mode = WAL")
    catalog.execute("PRAGMA synchronous = FULL")
    catalog.execute("CREATE TABLE scans (number INTEGER PRIMARY KEY, digest TEXT)")
    directory = os.open(folder, os.O_RDONLY)
    times, begun_cpu = [], time.process_time()
    for number in range(count):
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
    cpu_ms = 1e3 * (time.process_time() - begun_cpu) / count
    os.close(directory)
    catalog.close()
    return statistics.median(times), cpu_ms


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
    sys.exit(main(quick=len(sys.argv) > 1))
