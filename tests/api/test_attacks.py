"""Known attacks on services of this kind, each tried on ours.

Elsewhere: test_access.py, a key before the first request on an open address, and Host names;
test_limits_and_browsers.py, origins and preflights; test_map_file.py, links, filters and external
storage in HDF5; test_process.py, a kill after an acknowledged write, and paths over a socket;
test_listening.py, the address that is listened on.
"""

import ast
import os
import pickle
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import app
import core
import storage
from storage.catalog import RevisionFacts
from tests.support.map_files import revision_file
from tests.support.recording import KITTI, kitti, recording
from tests.support.service import copy_of, damage, problem_of, running, wait_for, whole_store

OUTSIDE = (
    "../secret.h5",
    "..%2Fsecret.h5",
    "%2e%2e%2fsecret.h5",
    "..%252fsecret.h5",
    "....//secret.h5",
    "..\\secret.h5",
    "/etc/passwd",
    "%2Fetc%2Fpasswd",
    "file:///etc/passwd",
    "secret.h5%00",
)
UNSAFE = {"pickle", "cPickle", "_pickle", "dill", "cloudpickle", "joblib", "marshal", "shelve"}
RUNS_TEXT = {"eval", "exec", "__import__"}


# A parameter or a part of a path that leads to a file outside (h5grove, OpenFLAME)


@pytest.fixture(scope="module")
def attacked(tmp_path_factory, built):
    """The built map, for attacks of which none may change anything."""
    data_dir = copy_of(built.data_dir, tmp_path_factory.mktemp("attacked") / "data")
    with running(data_dir) as client:
        yield client


@pytest.fixture(scope="module")
def secret(attacked):
    """A file beside the data and inside it, which no answer may hold."""
    folder = attacked.service.settings.data_dir
    for place in (folder.parent / "secret.h5", folder / "secret.h5"):
        place.write_bytes(b"\x89HDF\r\n\x1a\n the neighbours' map")
    return b"neighbours"


@pytest.mark.parametrize("name", OUTSIDE)
def test_no_name_leads_to_a_file(attacked, secret, name):
    before = whole_store(attacked)
    scan = kitti(recording().scans[0])
    requested = [
        attacked.get(f"/v1/maps/campus/revisions/{name}"),
        attacked.get(f"/v1/maps/campus/revisions/{name}/file"),
        attacked.get(f"/v1/maps/{name}"),
        attacked.get(f"/v1/maps/{name}/basis"),
        attacked.get(f"/v1/maps/campus/drives/{name}"),
        attacked.get(f"/v1/maps/campus/drives/{name}/scans/0"),
        attacked.put(f"/v1/maps/campus/drives/{name}/scans/0", content=scan, headers=KITTI),
        attacked.get(f"/v1/jobs/{name}"),
        attacked.delete(f"/v1/maps/campus/revisions/{name}"),
        attacked.delete(f"/v1/maps/{name}"),
        attacked.post("/v1/maps", json={"map": name}),
        attacked.get(f"/v1/jobs/{name}/events"),
        attacked.put("/v1/maps/campus/live", json={"revision": name}),
        attacked.post("/v1/maps/campus/builds", json={"drives": [name]}),
        attacked.get("/v1/maps/campus/basis", params={"revision": name}),
        attacked.get("/v1/maps/campus/topology", params={"revision": name}),
        attacked.post("/v1/maps/campus/tracks", params={"revision": name}),
    ]
    for answer in requested:
        assert problem_of(answer)[0] in {404, 405, 422}, (answer.request.url, answer.text)
        assert secret not in answer.content
        assert b"root:" not in answer.content
    assert whole_store(attacked) == before


@pytest.mark.parametrize("parameter", ["file", "path", "filename", "url"])
def test_a_parameter_that_names_a_file_is_refused(attacked, secret, parameter):
    for path in (
        "/v1/maps",
        "/v1/maps/campus",
        "/v1/maps/campus/revisions",
        "/v1/maps/campus/basis",
    ):
        for name in OUTSIDE:
            refused = attacked.get(path, params={parameter: name})
            assert problem_of(refused) == (422, "invalid-request")
            assert secret not in refused.content


# Bytes that run when they are read (OpenFLAME)


class Bomb:
    """Leaves a trace in the file system when it is unpickled."""

    def __init__(self, trace):
        self.trace = trace

    def __reduce__(self):
        return os.mkdir, (str(self.trace),)


def test_the_bomb_goes_off_when_it_is_unpickled(tmp_path):
    pickle.loads(pickle.dumps(Bomb(tmp_path / "trace")))
    assert (tmp_path / "trace").exists()


@pytest.mark.parametrize(
    "media_type",
    [
        "application/octet-stream",
        "application/vnd.tensormap.npy",
        "application/vnd.tensormap.kitti",
        "application/vnd.tensormap.signature",
        "application/vnd.tensormap.image",
        "application/python-pickle",
        "application/json",
        "application/vnd.tensormap.map+hdf5",
    ],
)
def test_no_body_runs(attacked, tmp_path, media_type):
    trace = tmp_path / "trace"
    header = b"\x93NUMPY\x01\x00\x76\x00" + (
        b"{'descr': '|O', 'fortran_order': False, 'shape': (1,), }".ljust(117) + b"\n"
    )
    for body in (pickle.dumps(Bomb(trace)), header + pickle.dumps([Bomb(trace)])):
        for method, path in (
            ("PUT", "drives/evil/scans/0"),
            ("POST", "localizations/scan"),
            ("POST", "localizations/signature"),
            ("POST", "localizations/image"),
            ("POST", "revisions"),
        ):
            answer = attacked.request(
                method,
                f"/v1/maps/campus/{path}",
                content=body,
                headers={"Content-Type": media_type},
            )
            assert problem_of(answer)[0] in {415, 422}, answer.text
    assert not trace.exists()
    drives = attacked.get("/v1/maps/campus/drives").json()["items"]
    assert [drive["drive"] for drive in drives] == ["monday"]


def test_no_cache_runs(own, tmp_path):
    trace = tmp_path / "trace"
    folder = own.service.settings.data_dir / "maps"
    caches = [path for path in folder.rglob("*.h5") if "revisions" not in path.parts]
    images = [path for path in caches if "images" in str(path)]
    assert images
    for path in images:
        damage(path, pickle.dumps(Bomb(trace)))
    wanted = {"segments": 4, "encoding": "paper"}  # of the images that are there
    job = own.post("/v1/maps/campus/builds", json=wanted).json()["job"]
    assert wait_for(own, job)["state"] == "done"
    assert not trace.exists()


def modules():
    for package in (app, core, storage):
        yield from Path(package.__path__[0]).rglob("*.py")


def test_nothing_of_ours_reads_what_could_run():
    for path in modules():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                named = {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                named = {(node.module or "").partition(".")[0]}
            elif isinstance(node, ast.Call):
                named = {getattr(node.func, "id", "")} & RUNS_TEXT
                allowed = [word for word in node.keywords if word.arg == "allow_pickle"]
                assert all(
                    isinstance(word.value, ast.Constant) and word.value.value is False
                    for word in allowed
                ), path
            else:
                continue
            assert not named & (UNSAFE | RUNS_TEXT), path


# One "current map" for all clients (OpenVPS)


def test_requests_of_one_client_change_no_answer_to_another(own, built):
    own.post("/v1/maps", json={"map": "dock"})
    store = own.service.store
    source = revision_file(store, "campus", built.other)
    facts = RevisionFacts(encoding="paper", scans=48, segments=2, parameters={})
    store.revisions.add(
        store.maps.get("dock").id, built.other, lambda path: shutil.copy(source, path), facts
    )
    body = kitti(recording().scans[5])

    def query(number):
        slug = ("campus", "dock")[number % 2]
        path = f"/v1/maps/{slug}/localizations/scan"
        return slug, own.post(path, content=body, headers=KITTI).json()["revision"]

    with ThreadPoolExecutor(8) as pool:
        answers = set(pool.map(query, range(40)))
    assert answers == {("campus", built.live), ("dock", built.other)}
    track = own.post("/v1/maps/campus/tracks").json()["track"]
    assert problem_of(own.get(f"/v1/maps/dock/tracks/{track}")) == (404, "track-not-found")
