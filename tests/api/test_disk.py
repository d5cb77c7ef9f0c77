"""Full disks and changed files: reported by name, and nothing else is affected."""

import errno
import os
from pathlib import Path

import pytest
from sqlalchemy import event
from starlette.testclient import WebSocketDenialResponse

from app.revisions.schemas import BasisOut
from core.encodings.signature import pack_signatures
from storage.errors import CorruptFile, StorageUnavailable
from storage.files.map_file import read_map
from tests.support.catalog_rows import stored_scans
from tests.support.map_files import revision_file
from tests.support.recording import KITTI, kitti, recording, upload_scan
from tests.support.service import damage, problem_of, whole_store

PACKED = {"Content-Type": "application/vnd.tensormap.signature"}


def localize(client, scan):
    return client.post("/v1/maps/campus/localizations/scan", content=kitti(scan), headers=KITTI)


def test_a_full_disk_is_reported_and_nothing_is_lost(own, monkeypatch):
    def full(_descriptor):
        raise OSError(errno.ENOSPC, "No space left on device")

    before = whole_store(own)
    scan = recording().scans[0]
    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", full)
        for drive in ("monday", "new"):
            refused = upload_scan(own, "campus", drive, 900, scan)
            assert problem_of(refused) == (507, "storage-full")
        assert localize(own, scan).status_code == 200
    assert whole_store(own)[:3] == before[:3]
    stored = {name for name in whole_store(own)[3] if name.endswith((".h5", ".part"))}
    assert stored == {name for name in before[3] if name.endswith(".h5")}
    assert upload_scan(own, "campus", "monday", 900, scan).status_code == 201


@pytest.mark.parametrize("harm", ["one bit", "cut", "another", "gone", "no map"])
def test_a_damaged_revision_is_reported_and_the_others_answer(own, built, harm):
    signature = _signature_of(own, built.other)
    path = revision_file(own.service.store, "campus", built.live)
    whole = path.read_bytes()
    half = len(whole) // 2
    if harm == "one bit":
        damage(path, whole[:half] + bytes([whole[half] ^ 1]) + whole[half + 1 :])
    elif harm == "cut":
        damage(path, whole[:half])
    elif harm == "another":
        damage(path, revision_file(own.service.store, "campus", built.other).read_bytes())
    elif harm == "gone":
        path.unlink()
    else:
        damage(path, b"no map at all")
    scan = recording().scans[9]
    for _ in range(2):  # it is no better the second time
        for refused in (localize(own, scan), own.get("/v1/maps/campus/basis")):
            assert problem_of(refused) == (500, "corrupt-file")
    assert own.get("/readyz").status_code == 200
    answered = own.post(
        "/v1/maps/campus/localizations/signature", content=signature, headers=PACKED
    )
    assert answered.json()["revision"] == built.other
    own.put("/v1/maps/campus/live", json={"revision": built.other})
    assert localize(own, scan).json()["best"]["scan_index"] == 9


def test_a_map_file_with_a_changed_byte_is_read_as_it_was_or_not_at_all(client, built, tmp_path):
    whole = revision_file(client.service.store, "campus", built.live).read_bytes()
    path = tmp_path / "harmed.h5"
    refused = 0
    # Densely where HDF5 keeps its own structures, at the beginning, and sparsely in the arrays.
    for at in [*range(0, 6_000, 61), *range(6_000, len(whole), len(whole) // 100)]:
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0xFF]) + whole[at + 1 :])
        try:
            assert read_map(path).revision == built.live
        except CorruptFile:
            refused += 1
    assert refused > 50


def test_a_scan_whose_file_has_changed_is_not_given_back(own):
    for index in (5, 6):
        upload_scan(own, "campus", "tuesday", index, recording().scans[index])
    [chunk] = {
        record.chunk
        for record in stored_scans(own.service.store, "campus", "tuesday")
        if record.index == 5
    }
    [path] = own.service.settings.data_dir.rglob(chunk)
    whole = bytearray(path.read_bytes())
    whole[len(whole) // 2] ^= 1
    damage(path, whole)
    scans = "/v1/maps/campus/drives/tuesday/scans"
    assert problem_of(own.get(f"{scans}/5")) == (500, "corrupt-file")
    assert own.get(f"{scans}/6").status_code == 200


def _signature_of(client, revision):
    answer = client.get("/v1/maps/campus/basis", params={"revision": revision})
    basis = BasisOut.model_validate(answer.json()).to_core()
    return pack_signatures(basis.encode(basis.image(recording().scans[9])))


def test_a_catalog_that_turns_read_only_is_reported_and_nothing_is_lost(own):
    engine = own.service.store.catalog._database.engine
    before = whole_store(own)

    def refuse_writes(connection, _record):
        connection.execute("PRAGMA query_only = ON")

    event.listen(engine, "connect", refuse_writes)
    engine.dispose()
    scan = recording().scans[0]
    for refused in (
        own.post("/v1/maps", json={"map": "new"}),
        own.delete("/v1/maps/campus"),
        upload_scan(own, "campus", "monday", 900, scan),
        own.post("/v1/maps/campus/builds", json={"segments": 2}),
    ):
        assert problem_of(refused) == (503, "storage-read-only")
    assert localize(own, scan).status_code == 200
    event.remove(engine, "connect", refuse_writes)
    engine.dispose()
    assert whole_store(own) == before
    assert upload_scan(own, "campus", "monday", 900, scan).status_code == 201


@pytest.mark.parametrize(
    ("number", "problem"),
    [
        (errno.ENOSPC, (507, "storage-full")),
        (errno.EDQUOT, (507, "storage-full")),
        (errno.EFBIG, (507, "storage-full")),
        (errno.EROFS, (503, "storage-read-only")),
        (errno.EACCES, (503, "storage-read-only")),
    ],
)
@pytest.mark.parametrize("step", ["mkdir", "rename"])
def test_every_step_of_storing_a_scan_may_fail_and_leaves_nothing(
    own, monkeypatch, caplog, number, problem, step
):
    def fail(path, *_, **__):
        raise OSError(number, os.strerror(number), str(path))

    before = whole_store(own)
    with monkeypatch.context() as patched:
        patched.setattr(Path, step, fail)
        refused = upload_scan(own, "campus", "new", 0, recording().scans[0])
    assert problem_of(refused) == problem
    where = str(own.service.settings.data_dir.absolute())
    assert where not in refused.text  # a client need not know it
    assert where in caplog.text  # an operator does
    assert whole_store(own)[:3] == before[:3]
    assert not [name for name in whole_store(own)[3] if name.endswith(".part")]
    assert upload_scan(own, "campus", "new", 0, recording().scans[0]).status_code == 201


def test_a_stream_shows_no_cause_of_a_failing_disk_and_the_log_does(own, monkeypatch, caplog):
    def fail(*_):
        raise StorageUnavailable("the disk fails") from OSError(errno.EIO, "failed", "/inside")

    track = own.post("/v1/maps/campus/tracks").json()["track"]
    monkeypatch.setattr("app.tracking.stream_routes.track_of", fail)
    stream = own.websocket_connect(f"ws://127.0.0.1/v1/maps/campus/tracks/{track}/stream")
    with pytest.raises(WebSocketDenialResponse) as refused, stream:
        pass
    assert problem_of(refused.value) == (503, "storage-unavailable")
    assert "/inside" not in refused.value.text
    assert "/inside" in caplog.text


@pytest.mark.parametrize("error", [StorageUnavailable("it fails"), CorruptFile("it is damaged")])
def test_what_a_stream_cannot_read_is_logged_once_however_often_its_vehicle_sends(
    own, monkeypatch, caplog, error
):
    def fail(*_):
        raise error from OSError(errno.EIO, "failed", "/inside")

    track = own.post("/v1/maps/campus/tracks").json()["track"]
    observation = {"revision": "0" * 64, "signatures": [{"segment": 0, "values": [[1.0]]}]}
    with own.websocket_connect(f"ws://127.0.0.1/v1/maps/campus/tracks/{track}/stream") as stream:
        monkeypatch.setattr("app.tracking.routes.track_of", fail)
        for _ in range(3):
            stream.send_json(observation)
            assert stream.receive_json()["status"] >= 500
    [record] = [record for record in caplog.records if record.name == "tensormap.tracks"]
    assert f"/tracks/{track}/stream" in record.getMessage()
    assert not record.exc_info
