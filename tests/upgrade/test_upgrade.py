"""The data directory of an earlier version starts, answers and verifies as before."""

import base64
import io
import json
import tarfile
from pathlib import Path

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

from app.cli.main import cli
from storage.backup.backup import write_backup
from storage.backup.restore import restore_backup
from storage.catalog import AuditState
from storage.store import Store
from storage.store.verification import verify
from tests import golden
from tests.support.access import bearer
from tests.support.recording import KITTI
from tests.support.service import problem_of, running, wait_for
from tests.upgrade.make import ADMIN, ADMIN_KEY, digest_of, query

FOLDER = Path(golden.__file__).parent
RELEASED = [
    "data-83290e7.tar.xz",
    "data-2ea395c.tar.xz",
    "data-77f57f6.tar.xz",
    "data-0090448.tar.xz",
]
WITH_ANSWERS = RELEASED[1:]
"""Those that have answers to localizations, interrupted builds, and a backup."""
PLACE = ("segment", "fraction", "along_m", "drive", "scan_index", "distance", "timestamp_s", "pose")
"""What of a match is the same; how far the vehicle is from it decision 32 estimates better."""
NEAR_M = 1.0


def _unpack(name: str, folder: Path) -> None:
    with tarfile.open(FOLDER / name) as tar:
        if hasattr(tarfile, "tar_filter"):
            tar.extractall(folder, filter="tar")
        else:  # Python 3.11.2, which Debian 12 has, knows no filters
            tar.extractall(folder)


@pytest.fixture(params=RELEASED)
def released(request, tmp_path):
    """Return a data directory of a release, and what its service answered."""
    _unpack(request.param, tmp_path)
    return tmp_path / "data", json.loads((tmp_path / "answers.json").read_text())


@pytest.fixture(params=WITH_ANSWERS)
def answered(request, tmp_path):
    """Return a folder with a release's data and backup, and what it answered."""
    _unpack(request.param, tmp_path)
    return tmp_path, json.loads((tmp_path / "answers.json").read_text())


def holds(now, before):
    """Return whether a response has all that it had before; it may have more."""
    if isinstance(before, dict):
        return isinstance(now, dict) and all(
            name in now and holds(now[name], value) for name, value in before.items()
        )
    if isinstance(before, list):
        return len(now) == len(before) and all(map(holds, now, before))
    if isinstance(before, float):
        return now == pytest.approx(before, rel=1e-5, abs=1e-6)
    return now == before


def require_answers(client, recorded):
    """Send what was localized again, to the same live revisions, and require the same places.

    How partial views are compared, which all of these are in a map of any views, decision 30
    changed since: these answers are as whole as they were.
    """
    views = {item["revision"]: item["parameters"].get("views") for item in revisions_of(client)}
    for sent in recorded["localized"]:
        client.put("/v1/maps/plaza/live", json={"revision": sent["revision"]})
        body, headers = base64.b64decode(sent["body"]), {"Content-Type": sent["type"]}
        now, before = (
            client.post(sent["path"], content=body, headers=headers).json(),
            sent["answer"],
        )
        for field in ("revision", "live_revision", "segments_searched"):
            assert holds(now[field], before[field]), (sent["path"], field)
        if views[sent["revision"]] == "any":
            assert now.keys() >= before.keys()
            assert len(now["matches"]) == len(before["matches"])
            continue
        for field in ("ratio", "localized", "reason", "probability"):
            assert holds(now[field], before[field]), (sent["path"], field)
        found = [
            [answer["best"], answer["runner_up"], *answer["matches"]] for answer in (now, before)
        ]
        for match, earlier in zip(*found, strict=True):
            assert all(holds(match[field], earlier[field]) for field in PLACE), sent["path"]
        at, earlier_at = (answer["best"]["estimated_pose"] for answer in (now, before))
        for axis in ("x_m", "y_m"):
            assert at[axis] == pytest.approx(earlier_at[axis], abs=NEAR_M), sent["path"]


def revisions_of(client):
    return client.get("/v1/maps/plaza/revisions").json()["items"]


def of_monday(recorded):
    """Return the revision of the paper's encoding of the drive `monday`, built by the release."""
    items = recorded["answers"]["/v1/maps/campus/revisions"]["items"]
    [revision] = [item["revision"] for item in items if item["encoding"] == "paper"]
    return revision


def require_same_map(client, revision, before):
    """Require that a revision has the arrays of an earlier one.

    They have one name where both were made with the same linear algebra, of which processors have
    different ones: numbers that it computes differ in the last digits, all others do not.
    """
    files = [
        client.get(f"/v1/maps/campus/revisions/{name}/file").content for name in (revision, before)
    ]
    now, earlier = map(arrays_of, files)
    assert now.keys() == earlier.keys()
    for name, array in earlier.items():
        if array.dtype.kind == "f":
            np.testing.assert_allclose(now[name], array, rtol=1e-4, atol=1e-4, err_msg=name)
        else:
            np.testing.assert_array_equal(now[name], array, err_msg=name)


def arrays_of(file):
    """Return the arrays of an HDF5 file by their names."""
    found = {}
    with h5py.File(io.BytesIO(file)) as opened:
        opened.visititems(
            lambda name, item: (
                found.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None
            )
        )
    return found


def test_it_localizes_as_before_and_ends_the_builds_that_were_interrupted(answered):
    folder, recorded = answered
    with running(folder / "data", admin_key=ADMIN_KEY) as client:
        client.headers.update(ADMIN)
        require_answers(client, recorded)
        for job in ("interrupted", "waiting"):
            assert wait_for(client, recorded[job])["state"] == "done"


def test_its_backup_is_restored_and_answers(answered):
    folder, recorded = answered
    restore_backup(folder / "backup.tar", folder / "restored")
    with running(folder / "restored", admin_key=ADMIN_KEY) as client:
        client.headers.update(ADMIN)
        require_answers(client, recorded)
        assert wait_for(client, recorded["waiting"])["state"] == "done"


def test_it_starts_answers_as_before_and_can_be_written(released):
    data, recorded = released
    with running(data, admin_key=ADMIN_KEY) as client:
        assert client.get("/readyz").json()["ready"]
        client.headers.update(ADMIN)
        for path, before in recorded["answers"].items():
            now = client.get(path).json()
            if path.startswith("/v1/audit"):  # what the start did is added
                now["items"] = now["items"][: len(before["items"])]
            assert holds(now, before), path
        for path, before in recorded["downloads"].items():
            assert digest_of(client.get(path).content) == before, path
        url = "/v1/maps/campus/localizations/scan"
        fleet = {**KITTI, **bearer(recorded["secret"])}
        best = client.post(url, content=query(), headers=fleet).json()["best"]
        assert [best["drive"], best["scan_index"]] == recorded["best"]
        lost = {**KITTI, **bearer(recorded["revoked"])}
        assert problem_of(client.post(url, content=query(), headers=lost)) == (401, "key-refused")
        assert wait_for(client, recorded["waiting"])["state"] == "done"
        params = {"encoding": "paper", "segment_length": 5, "drives": ["monday"]}
        built = wait_for(client, client.post("/v1/maps/campus/builds", json=params).json()["job"])
        require_same_map(client, built["revision"], of_monday(recorded))
        tuesday = "/v1/maps/campus/drives/tuesday"
        assert client.get(tuesday).json()["mounting"] is None
        client.put(tuesday, json={"mounting": {"x_m": 1.0, "y_m": 0.0, "z_m": 1.73}})
        mounted = {**params, "drives": ["monday", "tuesday"]}
        job = client.post("/v1/maps/campus/builds", json=mounted).json()["job"]
        assert wait_for(client, job)["state"] == "done"
        depot = {"encoding": "paper", "segment_length": 2}
        job = client.post("/v1/maps/depot/builds", json=depot).json()["job"]
        assert wait_for(client, job)["state"] == "done"  # of images alone: its returns are gone


def test_it_verifies_before_and_after_its_first_start(released):
    data, recorded = released
    result = CliRunner().invoke(cli, ["verify", "--data", str(data)])
    assert (result.exit_code, "0 damaged or missing" in result.output) == (0, True), result.output
    with Store.serving(data) as store:
        assert verify(store).findings == ()
        assert store.audit.verify(AuditState(*recorded["audit"])).fault is None
        assert not [path for path in data.rglob("*") if path.stat().st_mode & 0o077]
        [stray] = data.rglob("stray.h5")
        assert stray.read_bytes() == b"named by no row"


def test_it_is_backed_up_and_restored(released, tmp_path):
    data, _ = released
    written = write_backup(data, tmp_path / "backup.tar")
    assert (written.damaged, written.missing) == ((), ())
    assert restore_backup(tmp_path / "backup.tar", tmp_path / "new").files == written.files
    with Store.serving(tmp_path / "new") as store:
        assert verify(store).findings == ()
