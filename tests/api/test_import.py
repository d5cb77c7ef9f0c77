"""A revision from another service: checked, rewritten, and with the same answers."""

import errno
import io
import tempfile
from dataclasses import replace
from pathlib import Path

import h5py
import pytest

from core.confidence.calibration import Calibration
from storage.catalog.scans import Scans
from storage.files.map_file import write_map
from tests import golden
from tests.support.recording import KITTI, kitti, recording, upload_scan
from tests.support.samples import sample_map
from tests.support.service import problem_of, whole_store

HDF5 = {"Content-Type": "application/vnd.tensormap.map+hdf5"}
REVISIONS = "/v1/maps/campus/revisions"


@pytest.fixture
def empty(emptied):
    return emptied


@pytest.fixture
def exported(client, built):
    return client.get(f"{REVISIONS}/{built.live}/file").content


def changed(body, change):
    file = io.BytesIO(body)
    with h5py.File(file, "r+") as opened:
        change(opened)
    return file.getvalue()


def test_a_build_on_an_imported_base_says_that_its_drives_were_never_stored(exported, empty):
    empty.post(REVISIONS, content=exported, headers=HDF5)
    refused = empty.post("/v1/maps/campus/builds", json={"base": "live", "refit": True})
    assert problem_of(refused) == (404, "drive-not-found")
    assert "is not stored, the base was imported: upload it, or" in refused.json()["detail"]


def test_an_imported_revision_answers_as_where_it_was_built(client, built, exported, empty):
    answer = empty.post(REVISIONS, content=exported, headers=HDF5)
    assert answer.status_code == 201, answer.text
    found = answer.json()
    assert (found["revision"], found["live"], found["job"]) == (built.live, True, None)
    assert found["parameters"]["imported"] is True
    assert answer.headers["Location"] == f"{REVISIONS}/{built.live}"
    scan = kitti(recording(noise_seed=7).scans[4])
    path = "/v1/maps/campus/localizations/scan"
    here, there = (c.post(path, content=scan, headers=KITTI).json() for c in (empty, client))
    assert here["matches"] == there["matches"]
    assert here["probability"] == there["probability"]
    assert empty.get(f"{REVISIONS}/{built.live}/file").status_code == 200


@pytest.mark.parametrize(
    "calibration", [None, Calibration(0.1, (0.0, 0.0, 0.0), (0.0, 0.0), (0.0, 0.0), least_cells=9)]
)
def test_an_imported_revision_says_whether_it_is_calibrated(empty, tmp_path, calibration):
    made = replace(sample_map(count=6, segment_length=3)[0], calibration=calibration)
    write_map(tmp_path / "map.h5", made)
    answer = empty.post(REVISIONS, content=(tmp_path / "map.h5").read_bytes(), headers=HDF5)
    assert answer.status_code == 201, answer.text
    assert answer.json()["parameters"]["calibrated"] is (calibration is not None)


def test_a_revision_that_the_map_has_is_imported_once(own, built, exported):
    before = whole_store(own)
    again = own.post(REVISIONS, content=exported, headers=HDF5)
    assert again.status_code == 200
    assert again.json()["created_at"] == own.get(f"{REVISIONS}/{built.live}").json()["created_at"]
    assert whole_store(own) == before


def test_an_import_is_made_live_on_request_only(own, built):
    other = own.get(f"{REVISIONS}/{built.other}/file").content
    own.delete(f"{REVISIONS}/{built.other}")
    assert not own.post(REVISIONS, content=other, headers=HDF5).json()["live"]
    live = own.post(REVISIONS, content=other, headers=HDF5, params={"make_live": True})
    assert live.json()["live"]


def test_an_import_reads_the_scans_of_the_drives_that_it_is_compared_on(own, built, monkeypatch):
    store, of_drive = own.service.store, Scans.of_drive
    upload_scan(own, "campus", "elsewhere", 0, recording().scans[0])
    other, live = (
        own.get(f"{REVISIONS}/{digest}/file").content for digest in (built.other, built.live)
    )
    own.delete(f"{REVISIONS}/{built.other}")
    names = {drive.id: drive.slug for drive in store.drives.of_map(store.maps.get("campus").id)}
    read = set()

    def read_facts(scans, drive_id):
        read.add(names[drive_id])
        return of_drive(scans, drive_id)

    monkeypatch.setattr(Scans, "of_drive", read_facts)
    assert own.post(REVISIONS, content=live, headers=HDF5).status_code == 200
    assert read == set()  # it is the live one
    imported = own.post(REVISIONS, content=other, headers=HDF5).json()
    assert read == set(imported["parameters"]["drives"])


def test_the_audit_log_names_an_imported_revision_and_whether_it_became_live(own, built):
    other = own.get(f"{REVISIONS}/{built.other}/file").content
    for query, detail in (("", built.other), ("?make_live=true", f"{built.other}, made live")):
        own.post(f"{REVISIONS}{query}", content=other, headers=HDF5)
        entry = own.get("/v1/audit?limit=1000").json()["items"][-1]
        assert (entry["action"], entry["detail"]) == ("import_a_revision", f"revision {detail}")


def test_no_build_is_based_on_an_import_without_its_drives(empty, exported):
    empty.post(REVISIONS, content=exported, headers=HDF5)
    plan = {"base": "live", "add": ["tuesday"]}
    answer = empty.post("/v1/maps/campus/builds", json=plan)
    assert problem_of(answer) == (404, "drive-not-found")


def one_more(file):
    file["signatures"].write_direct(file["signatures"][()] + 1)


SPOILT = {
    "empty": (lambda body: b"", "empty-body"),
    "cut off": (lambda body: body[: len(body) // 2], "invalid-map"),
    "not HDF5": (lambda body: b"not HDF5", "invalid-map"),
    "more": (lambda body: changed(body, lambda f: f.create_group("more")), "invalid-map"),
    "other numbers": (lambda body: changed(body, one_more), "invalid-map"),
    "other digest": (
        lambda body: changed(body, lambda f: f.attrs.create("digest", "0" * 64)),
        "invalid-map",
    ),
    "later format": (
        lambda body: changed(body, lambda f: f.attrs.create("format_version", 99)),
        "invalid-map",
    ),
}


@pytest.mark.parametrize(("spoil", "problem"), SPOILT.values(), ids=SPOILT.keys())
def test_an_invalid_map_file_is_refused_and_changes_nothing(empty, exported, spoil, problem):
    before = whole_store(empty)
    assert problem_of(empty.post(REVISIONS, content=spoil(exported), headers=HDF5)) == (
        422,
        problem,
    )
    assert whole_store(empty) == before


def test_a_file_with_a_link_to_another_is_refused(empty, exported, tmp_path):
    def link(file):
        del file["pose"]
        file["pose"] = h5py.ExternalLink(str(tmp_path / "secret.h5"), "pose")

    answer = empty.post(REVISIONS, content=changed(exported, link), headers=HDF5)
    assert problem_of(answer) == (422, "invalid-map")


def test_an_import_has_a_media_type_and_needs_an_existing_map(empty, exported):
    assert problem_of(empty.post(REVISIONS, content=exported)) == (415, "unsupported-body")
    nowhere = empty.post("/v1/maps/other/revisions", content=exported, headers=HDF5)
    assert problem_of(nowhere) == (404, "map-not-found")


@pytest.mark.parametrize("bit", [1, 2, 3])
def test_an_import_on_which_the_hdf5_library_never_ends_is_refused(empty, bit):
    """One bit of the size of the first text in the global heap of a file that HDF5 wrote."""
    older = (Path(golden.__file__).parent / "map-v1.h5").read_bytes()
    assert empty.post(REVISIONS, content=older, headers=HDF5).status_code == 201
    harmed = bytearray(older)
    harmed[harmed.index(b"GCOL") + 16 + 9] ^= 1 << bit
    refused = empty.post(REVISIONS, content=bytes(harmed), headers=HDF5)
    assert problem_of(refused) == (422, "invalid-map")
    assert empty.get("/livez").status_code == 200


def test_an_import_writes_no_copy_of_its_own(empty, exported, monkeypatch):
    """A disk that failed under that copy was reported as a map that is invalid."""

    def fail(*_args, **_options):
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(tempfile, "mkdtemp", fail)
    assert empty.post(REVISIONS, content=exported, headers=HDF5).status_code == 201
