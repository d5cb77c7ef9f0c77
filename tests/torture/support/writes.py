"""Every kind of write that a client or an operator requests, and how to see that it was kept."""

import abc
import json
import shutil
import sqlite3
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from types import MappingProxyType
from typing import Any

import httpx2

from tests.support.recording import NPY, TAR
from tests.torture.support.bodies import (
    HDF5,
    digest_of_file,
    digest_of_npy,
    driven_tar,
    map_file,
    noise,
    noise_digest,
    noise_tar,
)
from tests.torture.support.service import Tortured, named

_ENDED = {"done", "failed", "cancelled"}
_SCANS = 6
_COLLECTING_S = 0.2


class Write(abc.ABC):
    """One write, which is prepared, attempted once or twice, and looked at.

    Args:
        service: Whose.
        number: Makes it another one than all before.

    Attributes:
        lift: Makes the disk well again, some time after it failed; called while a write waits for
            something that needs it.
        variables: Of the environment of commands, so that they meet the same disk.
    """

    lift: Callable[[], None] = staticmethod(lambda: None)
    variables: Mapping[str, str] = MappingProxyType({})

    def __init__(self, service: Tortured, client: httpx2.Client, number: int) -> None:
        self.service, self.client = service, client
        self.number = number
        self.map = f"{type(self).__name__.lower()}-{number}"

    def prepare(self) -> None:
        """Do what has to be there before."""
        self.must("POST", "/v1/maps", json={"map": self.map})

    @abc.abstractmethod
    def attempt(self) -> str | None:
        """Request it; return `None` if it was acknowledged, else the name of the refusal."""

    @abc.abstractmethod
    def require_kept(self) -> None:
        """Require that what was acknowledged is there, bit for bit."""

    def require_usable(self) -> None:  # noqa: B027 - most are for nothing else
        """Require what else it is for to be possible."""

    def must(self, method: str, path: str, **body: Any) -> httpx2.Response:
        """Send a request that has to succeed."""
        answer = self.client.request(method, path, **body)
        assert answer.is_success, f"{method} {path}: {answer.status_code} {answer.text[:300]}"
        return answer

    def refusal_of(self, method: str, path: str, **body: Any) -> str | None:
        """Send a request; return the name of its refusal, `None` if it succeeded."""
        answer = self.client.request(method, path, **body)
        return None if answer.is_success else named(answer)


class PutScan(Write):
    """One scan."""

    def attempt(self) -> str | None:
        path = f"/v1/maps/{self.map}/drives/monday/scans/0"
        return self.refusal_of("PUT", path, content=noise(self.map), headers=NPY)

    def require_kept(self) -> None:
        got = self.must("GET", f"/v1/maps/{self.map}/drives/monday/scans/0")
        assert digest_of_npy(got.content) == noise_digest(self.map)


class PostTar(Write):
    """Several scans in one stream."""

    def attempt(self) -> str | None:
        scans: dict[int, tuple[object, ...]] = {i: (self.map, i) for i in range(_SCANS)}
        path = f"/v1/maps/{self.map}/drives/monday/scans"
        answer = self.client.post(path, content=noise_tar(scans), headers=TAR)
        if not answer.is_success:
            return named(answer)
        result = answer.json()
        assert result["scans_stored"] + result["scans_present"] == _SCANS, result
        return None

    def require_kept(self) -> None:
        for index in range(_SCANS):
            got = self.must("GET", f"/v1/maps/{self.map}/drives/monday/scans/{index}")
            assert digest_of_npy(got.content) == noise_digest(self.map, index)


class SetPoses(PostTar):
    """Poses of scans that are there."""

    def prepare(self) -> None:
        super().prepare()
        assert super().attempt() is None
        self.poses = {i: [self.number + i / 8, i, 0.5, 0.0, 0.0, 0.0, 1.0] for i in range(_SCANS)}

    def attempt(self) -> str | None:
        poses = [{"scan": scan, "pose": pose} for scan, pose in self.poses.items()]
        path = f"/v1/maps/{self.map}/drives/monday/poses"
        return self.refusal_of("PUT", path, json={"poses": poses})

    def require_kept(self) -> None:
        super().require_kept()
        assert poses_of(self.service.data_dir, self.map, "monday") == self.poses


class CloseDrive(Write):
    """A drive is closed, and its files are packed into one."""

    def prepare(self) -> None:
        super().prepare()
        for index in range(_SCANS):
            path = f"/v1/maps/{self.map}/drives/monday/scans/{index}"
            self.must("PUT", path, content=noise(self.map, index), headers=NPY)

    def attempt(self) -> str | None:
        path = f"/v1/maps/{self.map}/drives/monday"
        return self.refusal_of("PATCH", path, json={"closed": True})

    def require_kept(self) -> None:
        assert self.must("GET", f"/v1/maps/{self.map}/drives/monday").json()["closed"]
        PostTar.require_kept(self)  # type: ignore[arg-type]


class Import(Write):
    """A revision from elsewhere."""

    def __init__(self, service: Tortured, client: httpx2.Client, number: int) -> None:
        super().__init__(service, client, number)
        self.digest, self.body = map_file(number % 2, harmonic=bool(number % 2))

    def attempt(self) -> str | None:
        path = f"/v1/maps/{self.map}/revisions"
        return self.refusal_of("POST", path, content=self.body, headers=HDF5)

    def require_kept(self) -> None:
        live = self.must("GET", f"/v1/maps/{self.map}").json()["live_revision"]
        assert live == self.digest
        self.must("GET", f"/v1/maps/{self.map}/topology")
        require_revision(self, self.digest)


class Build(Write):
    """A build, with the images that it keeps."""

    encoding = "harmonic"

    def prepare(self) -> None:
        super().prepare()
        path = f"/v1/maps/{self.map}/drives/monday/scans"
        self.must("POST", path, content=driven_tar(_SCANS), headers=TAR, params={"format": "kitti"})

    def attempt(self) -> str | None:
        parameters = {"segments": 1, "encoding": self.encoding}
        answer = self.client.post(f"/v1/maps/{self.map}/builds", json=parameters)
        if not answer.is_success:
            return named(answer)
        job = ended_job(self.client, answer.json()["job"], lift=self.lift)
        if job["state"] != "done":
            return str(job["error"]["type"]).removeprefix("/problems/")
        self.digest = str(job["revision"])
        return None

    def require_kept(self) -> None:
        require_revision(self, self.digest)

    def require_usable(self) -> None:
        images = list(self.service.data_dir.glob("maps/*/drives/*/images/*.h5"))
        assert images
        of_the_same_images = {"segments": 1, "encoding": self.encoding, "ranks": [3, 3]}
        answer = self.must("POST", f"/v1/maps/{self.map}/builds", json=of_the_same_images)
        job = ended_job(self.client, answer.json()["job"])
        assert job["state"] == "done", job


class MakeLive(Write):
    """Another revision becomes live."""

    def prepare(self) -> None:
        super().prepare()
        for seed in range(2):
            _, body = map_file(seed)
            path = f"/v1/maps/{self.map}/revisions"
            self.must("POST", path, content=body, headers=HDF5)
        self.digest = map_file(1)[0]

    def attempt(self) -> str | None:
        return self.refusal_of("PUT", f"/v1/maps/{self.map}/live", json={"revision": self.digest})

    def require_kept(self) -> None:
        live = self.must("GET", f"/v1/maps/{self.map}").json()["live_revision"]
        assert live == self.digest
        for seed in range(2):
            require_revision(self, map_file(seed)[0])


class MakeMap(Write):
    """A map."""

    def prepare(self) -> None:
        pass

    def attempt(self) -> str | None:
        refusal = self.refusal_of("POST", "/v1/maps", json={"map": self.map})
        # It exists if the first attempt made it and its answer failed.
        return None if refusal == "map-exists" else refusal

    def require_kept(self) -> None:
        self.must("GET", f"/v1/maps/{self.map}")


class MakeKey(Write):
    """A key."""

    def prepare(self) -> None:
        pass

    def attempt(self) -> str | None:
        body = {"name": self.map, "scopes": ["maps:read"]}
        answer = self.client.post("/v1/keys", json=body)
        if not answer.is_success:
            return named(answer)
        self.secret = answer.json()["secret"]
        return None

    def require_kept(self) -> None:
        with self.service.client(self.secret) as holder:
            assert holder.get("/v1/maps").status_code == 200


class Collect(MakeLive):
    """A map's policy changes, and the collector removes a revision that it keeps no longer."""

    def prepare(self) -> None:
        super().prepare()
        _, body = map_file(2)
        self.must("POST", f"/v1/maps/{self.map}/revisions", content=body, headers=HDF5)

    def attempt(self) -> str | None:
        policy = {"retained_revisions": 0, "retained_for_days": 0}
        refusal = self.refusal_of("PATCH", f"/v1/maps/{self.map}", json={"retention": policy})
        time.sleep(_COLLECTING_S)  # under the same fault
        return refusal

    def require_kept(self) -> None:
        deadline = time.monotonic() + 60  # the live one and the newest one stay
        while len(kept := self._kept()) > 2 and time.monotonic() < deadline:
            assert self.attempt() is None  # what failed once is tried again when it is woken
            time.sleep(0.1)
        assert kept == {map_file(0)[0], map_file(2)[0]}
        for digest in kept:
            require_revision(self, digest)

    def _kept(self) -> set[str]:
        listed = self.must("GET", f"/v1/maps/{self.map}/revisions").json()["items"]
        return {item["revision"] for item in listed}


class Backup(Import):
    """A backup of everything, by command, beside the data.

    All attempts back up the same map: with one map more for each, a backup would have more calls
    than the one before it, and failing each of them in turn would never end.
    """

    def __init__(self, service: Tortured, client: httpx2.Client, number: int) -> None:
        super().__init__(service, client, 0)
        self.folder = service.data_dir.parent / "backups" / str(number)
        self.file = self.folder / "backup.tar"

    def prepare(self) -> None:
        if not self.client.get(f"/v1/maps/{self.map}").is_success:
            super().prepare()
            path = f"/v1/maps/{self.map}/revisions"
            self.must("POST", path, content=self.body, headers=HDF5)
        self.folder.mkdir(parents=True)

    def attempt(self) -> str | None:
        ended = self.service.command("backup", "-o", self.file, **self.variables)
        assert ended.returncode >= 0, f"signal {-ended.returncode}: {ended.stderr[-2000:]}"
        assert "Traceback" not in ended.stderr, ended.stderr[-2000:]
        left = [path.name for path in self.folder.iterdir() if path != self.file]
        assert not left, f"the backup leaves {left}"
        if ended.returncode == 0:
            return None
        if self.file.exists():  # the last sync failed: only a power failure could lose it
            self._require_whole()
        return "storage-unavailable"  # a command names it in words only

    def require_kept(self) -> None:
        self._require_whole()
        super().require_kept()

    def _require_whole(self) -> None:
        new = self.folder / "restored"
        ended = self.service.command("restore", self.file, "--data", new)
        assert ended.returncode == 0, ended.stderr
        assert sum(1 for _ in new.rglob("revisions/*.h5")) > 0
        shutil.rmtree(new)


WRITES: tuple[type[Write], ...] = (
    PutScan, PostTar, SetPoses, CloseDrive, Import, Build, MakeLive, MakeMap, MakeKey, Collect,
    Backup,
)  # fmt: skip


def require_revision(write: Write, digest: str) -> None:
    """Require a map's revision to be read to its last byte, and to be what it is called."""
    got = write.must("GET", f"/v1/maps/{write.map}/revisions/{digest}/file")
    assert digest_of_file(got.content) == digest


def ended_job(
    client: httpx2.Client,
    job: str,
    *,
    within_s: float = 300.0,
    lift: Callable[[], None] = lambda: None,
) -> dict[str, Any]:
    """Poll a job to its end; what cannot be read now may be read later.

    How a job ended cannot be written down while no write succeeds: after a while `lift` ends that.
    """
    deadline = time.monotonic() + within_s
    while time.monotonic() < deadline:
        lift()
        answer = client.get(f"/v1/jobs/{job}")
        if answer.is_success and answer.json()["state"] in _ENDED:
            ended: dict[str, Any] = answer.json()
            return ended
        if not answer.is_success:
            assert named(answer).startswith("storage-"), answer.text
        time.sleep(0.05)
    raise AssertionError(f"job {job} does not end: {answer.text[:500]}")


def poses_of(data_dir: Path, of_map: str, drive: str) -> dict[int, list[float] | None]:
    """Return the poses that a catalog holds; no route gives them back."""
    statement = """SELECT scan_index, pose FROM scans JOIN drives ON drives.id = scans.drive_id
                JOIN maps ON maps.id = drives.map_id WHERE maps.slug = ? AND drives.slug = ?"""
    with closing(sqlite3.connect(f"file:{data_dir}/catalog.sqlite3?mode=ro", uri=True)) as catalog:
        rows = catalog.execute(statement, (of_map, drive)).fetchall()
    return {index: None if pose is None else json.loads(pose) for index, pose in rows}
