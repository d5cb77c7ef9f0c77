"""Hours of ordinary use in minutes: memory, threads and descriptors stay flat, and nothing fails.

`make soak` takes half an hour, or `TENSORMAP_SOAK_S`; `.ci/run` takes a minute, which shows threads
and descriptors, and little about memory.
"""

import threading
import time
from collections import Counter
from pathlib import Path

import httpx2
import pytest

from tests.support.recording import KITTI, NPY, TAR, kitti
from tests.torture.support.bodies import HDF5, driven, driven_tar, map_file, noise, noise_tar
from tests.torture.support.service import Tortured, tortured
from tests.torture.support.sizes import chance, seconds
from tests.torture.support.watching import Meter
from tests.torture.support.writes import ended_job

pytestmark = [pytest.mark.torture, pytest.mark.alone, pytest.mark.soak]

_SOAK_S = seconds("TENSORMAP_SOAK_S", 60.0)
_WARM_SHARE = 0.4  # caches fill, threads start
_EVERY_S = 1.0
_CLIENTS = 4
_SCANS = 12
_KEPT = 3  # drives and revisions of a client, so that what is stored stays as much


class User:
    """A client with a key and a map of its own, who does what users do."""

    def __init__(self, service: Tortured, number: int) -> None:
        self.map, self._chance = f"soak-{number}", chance("soak", number)
        self.statuses: Counter[str] = Counter()
        self.faults: list[str] = []
        self._round = 0
        with service.client() as admin:
            admin.post("/v1/maps", json={"map": self.map}).raise_for_status()
            body = {"name": self.map, "scopes": ["maps:read", "maps:write", "localize"]}
            made = admin.post("/v1/keys", json=body).raise_for_status().json()
            policy = {"retention": {"retained_revisions": 1, "retained_for_days": 0}}
            admin.patch(f"/v1/maps/{self.map}", json=policy).raise_for_status()
        self.client = service.client(made["secret"])
        path = f"/v1/maps/{self.map}/drives/monday/scans"
        form = {"format": "kitti"}
        self._done("POST", path, content=driven_tar(_SCANS), headers=TAR, params=form)
        self._build()

    def use_until(self, stop: threading.Event) -> None:
        """Do one thing after the other."""
        steps = [self._localize] * 12 + [self._put] * 4 + [self._look] * 4
        steps += [self._track, self._import, self._refused, self._build]
        try:
            while not stop.is_set():
                self._round += 1
                self._chance.choice(steps)()
        except (AssertionError, httpx2.HTTPError) as error:
            self.faults.append(repr(error))
        finally:
            self.client.close()

    def _done(self, method: str, path: str, **body: object) -> httpx2.Response:
        """Send what has to succeed."""
        answer = self._send(method, path, **body)
        assert answer.is_success, f"{method} {path}: {answer.status_code} {answer.text[:300]}"
        return answer

    def _send(self, method: str, path: str, **body: object) -> httpx2.Response:
        answer = self.client.request(method, path, **body)  # type: ignore[arg-type]
        self.statuses[f"{answer.status_code // 100}xx"] += 1
        assert answer.status_code < 500, f"{method} {path}: {answer.text[:300]}"
        return answer

    def _localize(self) -> None:
        body = kitti(driven(self._chance.randrange(_SCANS)))
        path = f"/v1/maps/{self.map}/localizations/scan"
        self._done("POST", path, content=body, headers=KITTI)

    def _put(self) -> None:
        drive = f"drive-{self._round % _KEPT}"
        path = f"/v1/maps/{self.map}/drives/{drive}"
        self._send("DELETE", path)  # there is none the first time
        self._done("PUT", f"{path}/scans/0", content=noise(self.map, self._round), headers=NPY)
        body = noise_tar({index: (self.map, self._round, index) for index in range(1, 6)})
        self._done("POST", f"{path}/scans", content=body, headers=TAR)
        poses = [{"scan": 0, "pose": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]}]
        self._done("PUT", f"{path}/poses", json={"poses": poses})
        self._done("PATCH", path, json={"closed": True})

    def _look(self) -> None:
        for path in ("", "/drives", "/revisions", "/topology", "/basis"):
            self._done("GET", f"/v1/maps/{self.map}{path}")
        self._done("GET", "/v1/jobs")

    def _track(self) -> None:
        path = f"/v1/maps/{self.map}/tracks"
        track = self._done("POST", path).json()["track"]
        for index in range(3):
            body = kitti(driven(index))
            self._done("POST", f"{path}/{track}/observations", content=body, headers=KITTI)
        self._done("DELETE", f"{path}/{track}")

    def _import(self) -> None:
        _, body = map_file(self._round % 4, harmonic=self._round % 2 == 1)
        path = f"/v1/maps/{self.map}/revisions"
        imported = self._done("POST", path, content=body, headers=HDF5).json()
        self._send("GET", f"{path}/{imported['revision']}/file")  # one that is not kept may be gone

    def _refused(self) -> None:
        self._send(
            "PUT", f"/v1/maps/{self.map}/drives/x/scans/0", content=b"\0" * 1000, headers=NPY
        )
        self._send("POST", f"/v1/maps/{self.map}/revisions", content=b"\0" * 1000, headers=HDF5)
        self._send("POST", f"/v1/maps/{self.map}/builds", json={"no": "such"})

    def _build(self) -> None:
        parameters = {
            "segments": 1,
            "drives": ["monday"],
            "sensor_height_m": 1.7 + self._round % 50 / 1000,
        }
        answer = self._done("POST", f"/v1/maps/{self.map}/builds", json=parameters)
        assert ended_job(self.client, answer.json()["job"])["state"] == "done"


def test_a_service_in_use_does_not_grow(tmp_path: Path) -> None:
    with tortured(tmp_path, build_workers="1") as service:
        users = [User(service, number) for number in range(_CLIENTS)]
        stop = threading.Event()
        using = [threading.Thread(target=user.use_until, args=(stop,)) for user in users]
        meter, began = Meter(service), time.monotonic()
        for thread in using:
            thread.start()
        while time.monotonic() < began + _SOAK_S and not any(user.faults for user in users):
            meter.look()
            time.sleep(_EVERY_S)
        stop.set()
        for thread in using:
            thread.join()
        faults = [fault for user in users for fault in user.faults]
        statuses = sum((user.statuses for user in users), Counter[str]())
        print(f"{_SOAK_S:.0f} s: {dict(statuses)}")
        assert not faults, faults
        wrong = meter.faults(began + _WARM_SHARE * _SOAK_S)
        assert not wrong, wrong
        assert service.pid in meter.measured
        assert "Traceback" not in service.log.read_text(errors="replace")
        assert service.is_alive
        service.stop()
    disk = service.data_dir.parent
    left = [*disk.rglob("*.part"), *(path for path in disk.glob("tmp/**/*") if path.is_file())]
    assert not left, left
