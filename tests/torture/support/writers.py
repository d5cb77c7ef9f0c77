"""Clients that write whatever can be written, in an order that chance chooses."""

import json
import random
import threading
from collections import defaultdict
from typing import Any

import httpx2

from tests.support.recording import NPY, TAR
from tests.torture.support.bodies import (
    HDF5,
    driven_tar,
    map_file,
    noise,
    noise_digest,
    noise_tar,
)
from tests.torture.support.ledger import Ledger, Refused, Thing
from tests.torture.support.service import Tortured, named

_REVISIONS = 4
_BUILT = 6  # scans that a build takes
_HANGS_S = 120.0  # an answer takes no time near that, on a busy machine too
_WEIGHTS = {
    "put_scan": 8,
    "put_tar": 4,
    "put_poses": 4,
    "close": 1,
    "delete_drive": 1,
    "import_revision": 3,
    "make_live": 2,
    "delete_revision": 1,
    "make_key": 1,
    "revoke_key": 1,
    "build": 1,
}


class Writer:
    """One client with maps of its own, so that it knows what they hold.

    Args:
        number: Which client.
        ledger: Where it writes down what was acknowledged.
        chance: What it does next.

    Attributes:
        jobs: The builds that it was promised, by their ids.
        faults: Answers that no kill explains.
    """

    def __init__(self, number: int, ledger: Ledger, chance: random.Random) -> None:
        self.map, self.built = f"writer-{number}", f"built-{number}"
        self._ledger, self._chance = ledger, chance
        self._drive = 0
        self._indices: defaultdict[str, list[int]] = defaultdict(list)
        self.jobs: list[str] = []
        self._built_anew = 0
        self.faults: list[str] = []

    def make(self, client: httpx2.Client) -> None:
        """Make its maps."""
        self._client = client
        for of_map in (self.map, self.built):
            client.post("/v1/maps", json={"map": of_map}).raise_for_status()
        path = f"/v1/maps/{self.built}/drives/monday/scans"
        kitti = {"format": "kitti"}
        sent = client.post(path, content=driven_tar(_BUILT), headers=TAR, params=kitti)
        sent.raise_for_status()

    def write_until(
        self, service: Tortured, stop: threading.Event, ending: threading.Event
    ) -> None:
        """Write one thing after the other until the service is gone.

        Args:
            service: Where to.
            stop: Ends it, too.
            ending: Is set before the service is ended; a connection that fails earlier is a fault,
                one that is not answered always.
        """
        with service.client(timeout=_HANGS_S) as self._client:
            while not stop.is_set():
                [step] = self._chance.choices(list(_WEIGHTS), list(_WEIGHTS.values()))
                try:
                    getattr(self, f"_{step}")()
                except Refused:
                    pass
                except httpx2.TransportError as error:
                    if isinstance(error, httpx2.TimeoutException) or not ending.is_set():
                        self.faults.append(f"{step}, which no kill explains: {error!r}")
                    return
                except AssertionError as error:
                    self.faults.append(f"{step}: {error}")
                    return

    def _send(self, method: str, path: str, **body: Any) -> httpx2.Response:
        answer = self._client.request(method, path, **body)
        if answer.is_success:
            return answer
        name = named(answer)
        assert answer.status_code < 500, f"{method} {path}: {answer.text[:500]}"
        raise Refused(name)

    def _scan(self, index: int) -> tuple[Thing, str]:
        where = (self.map, self._name, str(index))
        return ("scan", *where), noise_digest(*where)

    @property
    def _name(self) -> str:
        return f"drive-{self._drive}"

    def _new_indices(self, count: int) -> list[int]:
        known = self._indices[self._name]
        first = known[-1] + 1 if known else 0
        known.extend(range(first, first + count))
        return known[-count:]

    def _put_scan(self) -> None:
        [index] = self._new_indices(1)
        path = f"/v1/maps/{self.map}/drives/{self._name}/scans/{index}"
        with self._ledger.writing(dict([self._scan(index)])):
            self._send("PUT", path, content=noise(self.map, self._name, str(index)), headers=NPY)

    def _put_tar(self) -> None:
        indices = self._new_indices(self._chance.randint(2, 8))
        body = noise_tar({i: (self.map, self._name, str(i)) for i in indices})
        with self._ledger.writing(dict(map(self._scan, indices))):
            result = self._send(
                "POST", f"/v1/maps/{self.map}/drives/{self._name}/scans", content=body, headers=TAR
            ).json()
            assert result["scans_stored"] == len(indices), result

    def _put_poses(self) -> None:
        there = [i for i in self._indices[self._name] if self._ledger.value(self._scan(i)[0])]
        chosen = self._chance.sample(there, min(5, len(there)))
        if not chosen:
            return
        poses = {
            i: [self._chance.randint(0, 999) / 8, float(i), 0.0, 0.0, 0.0, 0.0, 1.0] for i in chosen
        }
        body = {"poses": [{"scan": scan, "pose": pose} for scan, pose in poses.items()]}
        things = {("pose", self.map, self._name, str(i)): json.dumps(p) for i, p in poses.items()}
        with self._ledger.writing(things):  # type: ignore[arg-type]
            self._send("PUT", f"/v1/maps/{self.map}/drives/{self._name}/poses", json=body)

    def _close(self) -> None:
        if not self._indices[self._name]:
            return
        path = f"/v1/maps/{self.map}/drives/{self._name}"
        try:
            with self._ledger.writing({("closed", self.map, self._name): "closed"}):
                self._send("PATCH", path, json={"closed": True})
        finally:
            self._drive += 1  # perhaps it is closed

    def _delete_drive(self) -> None:
        gone = f"drive-{self._chance.randint(0, self._drive)}"
        if gone == self._name or not self._indices[gone]:
            return
        things = [t for t in self._ledger.things() if t[1:3] == (self.map, gone)]
        with self._ledger.writing(dict.fromkeys(things)):
            self._send("DELETE", f"/v1/maps/{self.map}/drives/{gone}")

    def _import_revision(self) -> None:
        number = self._chance.randrange(_REVISIONS)
        digest, body = map_file(number, harmonic=number % 2 == 1)
        things: dict[Thing, str | None] = {("revision", self.map, digest): digest}
        if self._ledger.value(("live", self.map)) is None:
            things["live", self.map] = digest
        with self._ledger.writing(things):
            self._send("POST", f"/v1/maps/{self.map}/revisions", content=body, headers=HDF5)

    def _make_live(self) -> None:
        digest = self._known_revision()
        if digest is None:
            return
        with self._ledger.writing({("live", self.map): digest}):
            self._send("PUT", f"/v1/maps/{self.map}/live", json={"revision": digest})

    def _delete_revision(self) -> None:
        digest = self._known_revision()
        if digest is None:
            return
        with self._ledger.writing({("revision", self.map, digest): None}):
            self._send("DELETE", f"/v1/maps/{self.map}/revisions/{digest}")  # not if it is live

    def _known_revision(self) -> str | None:
        things = [t for t in self._ledger.things() if t[:2] == ("revision", self.map)]
        there = [t[2] for t in things if self._ledger.value(t) is not None]
        return self._chance.choice(there) if there else None

    def _make_key(self) -> None:
        body = {"name": self.map, "scopes": ["maps:read"]}
        made = self._send("POST", "/v1/keys", json=body).json()
        self._ledger.note(("key", made["key"], made["secret"]), "opens")

    def _revoke_key(self) -> None:
        mine = [t for t in self._ledger.things() if t[0] == "key" and self._ledger.value(t)]
        if not mine:
            return
        thing = self._chance.choice(mine)
        with self._ledger.writing({thing: None}):
            self._send("DELETE", f"/v1/keys/{thing[1]}")

    def _build(self) -> None:
        self._built_anew += 1
        parameters = {"segments": 1, "sensor_height_m": 1.5 + self._built_anew / 1000}
        answer = self._send("POST", f"/v1/maps/{self.built}/builds", json=parameters)
        self.jobs.append(answer.json()["job"])
