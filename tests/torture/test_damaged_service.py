"""A service that is sent damaged maps, or whose own files are damaged, serves the others."""

import hashlib
import sqlite3
import time
from contextlib import closing
from pathlib import Path

import httpx2
import pytest

from tests.support.recording import KITTI, NPY, TAR, kitti
from tests.torture.support.bodies import HDF5, driven, driven_tar, map_file, noise
from tests.torture.support.damage import damaged
from tests.torture.support.hostile import hostile_maps, truncated_maps
from tests.torture.support.service import Tortured, named, tortured
from tests.torture.support.sizes import chance, size
from tests.torture.support.watching import watching
from tests.torture.support.writes import ended_job

_IMPORTS = size("imports", 200)
_STORED = size("stored", 25)
_HANGS_S = 20.0
_SCANS = 6


@pytest.fixture
def service(tmp_path):
    with tortured(tmp_path) as running:
        yield running


def answered(service: Tortured, method: str, path: str, **options) -> str:
    """Return a success's status or a problem's name; restart a service that hangs or has ended."""
    return answer_of(service, method, path, **options)[0]


def answer_of(service: Tortured, method: str, path: str, **options) -> tuple[str, str]:
    """Return the same, and a digest of the content of a success."""
    try:
        with service.client(timeout=_HANGS_S) as client:
            answer = client.request(method, path, **options)
    except httpx2.TransportError as error:
        how = "hangs" if service.is_alive else f"ended: {service.crash_report()}"
        if service.is_alive:
            service.kill()
        service.start()
        return f"THE SERVICE {how} ({error!r})", ""
    if not answer.is_success:
        return named(answer), ""
    return str(answer.status_code), hashlib.sha256(answer.content).hexdigest()


def hostile_bodies() -> list[tuple[str, bytes]]:
    bodies = [(name, body) for name, body in hostile_maps().items() if " at " not in name]
    bodies += [(f"{len(body)} bytes", body) for body in truncated_maps(1511)]
    chosen = chance("imports")
    for number in range(_IMPORTS):
        _, sound = map_file(0, harmonic=number % 2 == 1)
        bodies.append((f"damaged {number}", damaged(sound, chosen)))
    return bodies


def test_damaged_maps_are_refused_by_name_and_others_are_answered_meanwhile(service):
    with service.client() as client:
        client.post("/v1/maps", json={"map": "target"}).raise_for_status()
    wrong = []
    with watching(service) as watch:
        for name, body in hostile_bodies():
            path = "/v1/maps/target/revisions"
            outcome = answered(service, "POST", path, content=body, headers=HDF5)
            if outcome not in {"200", "201", "invalid-map", "empty-body"}:
                wrong.append(f"{name}: {outcome}")
    assert not wrong, f"{len(wrong)}:\n" + "\n".join(wrong[:10])
    watch.require()
    with service.client() as client:
        listed = client.get("/v1/maps/target/revisions", params={"limit": 1000}).raise_for_status()
        for item in listed.json()["items"]:  # nothing that cannot be shown was taken
            of_it = {"revision": item["revision"]}
            client.get("/v1/maps/target/topology", params=of_it).raise_for_status()


class Damaged:
    """Maps whose files are damaged one by one, and the requests that then read them."""

    def __init__(self, service: Tortured, kind: str, number: int) -> None:
        self.service, self.kind = service, kind
        self.map = f"{kind}-{number}"
        self.chance = chance("stored", kind, number)

    def make(self) -> None:
        with self.service.client() as client:
            client.post("/v1/maps", json={"map": self.map}).raise_for_status()
            base = f"/v1/maps/{self.map}"
            if self.kind == "revision":
                body = map_file(0)[1]
                client.post(f"{base}/revisions", content=body, headers=HDF5).raise_for_status()
            elif self.kind == "chunk":
                path = f"{base}/drives/monday/scans/0"
                client.put(path, content=noise(self.kind), headers=NPY).raise_for_status()
            else:
                path = f"{base}/drives/monday/scans"
                form = {"format": "kitti"}
                sent = client.post(path, content=driven_tar(_SCANS), headers=TAR, params=form)
                sent.raise_for_status()
                assert self.build([5, 5])[0] == "done"

    def build(self, ranks: list[int]) -> tuple[str, str]:
        with self.service.client() as client:
            parameters = {"segments": 1, "ranks": ranks}
            answer = client.post(f"/v1/maps/{self.map}/builds", json=parameters)
            if not answer.is_success:
                return named(answer), ""
            job = ended_job(client, answer.json()["job"])
            done = job["state"] == "done"
            return ("done", job["revision"]) if done else (job["error"]["type"], "")

    def harm(self, before: set[Path]) -> None:
        """Put a damaged file in the place of the one that was made."""
        pattern = {"revision": "revisions/*.h5", "chunk": "chunks/*.h5", "images": "images/*.h5"}
        new = set(self.service.data_dir.rglob(pattern[self.kind])) - before
        assert new
        for path in new:
            content = damaged(path.read_bytes(), self.chance)
            mode = path.stat().st_mode
            path.unlink()
            path.write_bytes(content)
            path.chmod(mode)

    def query(self) -> tuple[str, str]:
        """Return how it was answered, and a digest of the content of a success."""
        base = f"/v1/maps/{self.map}"
        if self.kind == "revision":
            return answer_of(self.service, "GET", f"{base}/topology")
        if self.kind == "chunk":
            return answer_of(self.service, "GET", f"{base}/drives/monday/scans/0")
        return self.build([3, 3])


_REFUSALS = {
    "revision": {"corrupt-file", "revision-not-found", "no-live-revision"},
    "chunk": {"corrupt-file", "scan-not-found"},
    "images": {"/problems/corrupt-images", "corrupt-images"},
}


@pytest.mark.parametrize("kind", _REFUSALS)
def test_damaged_files_of_the_service_fail_by_name_and_the_others_are_served(service, kind):
    wrong = []
    count = _STORED if kind != "images" else max(3, _STORED // 5)
    sound = map_file(1)[1]
    with service.client() as client:
        client.post("/v1/maps", json={"map": "sound"}).raise_for_status()
        client.post("/v1/maps/sound/revisions", content=sound, headers=HDF5).raise_for_status()
    whole = Damaged(service, kind, count)
    whole.make()
    answer = whole.query()
    assert answer[0] in {"200", "done"}
    with watching(service) as watch:
        for number in range(count):
            before = set(service.data_dir.rglob("*.h5"))
            one = Damaged(service, kind, number)
            one.make()
            one.harm(before)
            found = one.query()
            # The damage may be where nothing is read; then the answer is that of an undamaged one.
            if found != answer and found[0] not in _REFUSALS[kind]:
                wrong.append(f"{kind} {number}: {found[0]}, not as a whole one")
    assert not wrong, f"{len(wrong)} of {count}:\n" + "\n".join(wrong[:10])
    watch.require()
    with service.client() as client:
        client.get("/v1/maps/sound/topology").raise_for_status()
    require_backup_ends(service)
    service.kill()
    service.start()  # on damaged files, too
    with service.client() as client:
        client.get("/v1/maps/sound/topology").raise_for_status()


def require_backup_ends(service: Tortured) -> None:
    """Require a backup of damaged files to be made or refused, and not to hang or crash."""
    output = service.data_dir.parent / "backup.tar"
    began = time.monotonic()
    ended = service.command("backup", "-o", output, "--data", service.data_dir)
    assert ended.returncode in {0, 1}, f"{ended.returncode}: {ended.stderr[-2000:]}"
    assert "Traceback" not in ended.stderr, ended.stderr[-2000:]
    assert time.monotonic() - began < 100.0


def test_a_query_of_a_damaged_live_revision_does_not_stop_others(service):
    """The sector of a map that vehicles use goes bad while they use another."""
    with service.client() as client:
        for name in ("bad", "good"):
            client.post("/v1/maps", json={"map": name}).raise_for_status()
            path = f"/v1/maps/{name}/drives/monday/scans"
            form = {"format": "kitti"}
            client.post(path, content=driven_tar(_SCANS), headers=TAR, params=form)
            job = client.post(f"/v1/maps/{name}/builds", json={"segments": 1}).json()["job"]
            assert ended_job(client, job)["state"] == "done"
        live = client.get("/v1/maps/bad").json()["live_revision"]
    service.kill()
    [path] = [p for p in service.data_dir.rglob(f"revisions/{live}*") if _of(service, "bad", p)]
    content = bytearray(path.read_bytes())
    content[len(content) // 3 : len(content) // 3 + 512] = chance("live").randbytes(512)
    path.unlink()
    path.write_bytes(content)
    service.start()
    body = kitti(driven(2))
    refusals = _REFUSALS["revision"]  # no answer is right: the sector has numbers of the map
    with watching(service) as watch:
        for _ in range(5):
            path_of = "/v1/maps/{}/localizations/scan"
            bad = answered(service, "POST", path_of.format("bad"), content=body, headers=KITTI)
            good = answered(service, "POST", path_of.format("good"), content=body, headers=KITTI)
            assert bad in refusals
            assert good == "200"
    watch.require()


def _of(service: Tortured, slug: str, path: Path) -> bool:
    """Return whether a revision's file is of a map: its folder is named by an id."""
    with closing(sqlite3.connect(service.data_dir / "catalog.sqlite3")) as catalog:
        statement = "SELECT 1 FROM maps WHERE slug = ? AND id = ?"
        return bool(catalog.execute(statement, (slug, path.parents[1].name)).fetchone())
