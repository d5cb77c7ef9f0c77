"""Drives added to a map, aged and left out, while vehicles keep the basis that they hold."""

from contextlib import contextmanager
from datetime import UTC, datetime, timedelta

import pytest
from tensormap_client import Vehicle

from app.localization.signature_schemas import SignaturesIn
from core.encodings.signature import pack_signatures
from storage.catalog.models import Drive, RevisionBasis
from tests.support.campus import BUILDS, PACKED, basis_of, build, localize
from tests.support.client_calls import HERE, watched
from tests.support.map_files import revision_file
from tests.support.recording import Recording, recording
from tests.support.service import (
    copy_of,
    damage,
    problem_of,
    running,
    upload,
    whole_store,
)

PARAMETERS = {
    # Built fastest: nothing but one test depends on views, and all pass places on the same line.
    "harmonic": {
        "encoding": "harmonic",
        "segment_length": 8,
        "lateral_renderings_m": [0.0],
        "views": "full",
    },
    "paper": {"encoding": "paper", "segment_length": 8},
}


def as_json(signatures):
    return SignaturesIn.from_core(signatures).model_dump(exclude_none=True)


def revision_of(client, job):
    return client.get(f"/v1/maps/campus/revisions/{job['revision']}").json()


@pytest.fixture(scope="module", params=["harmonic", "paper"])
def encoding(request):
    return request.param


@contextmanager
def two_halves(data_dir, encoding):
    """Run a map of the first half of a drive, live, and the second half stored beside it.

    The images of both are made, which tests that add the second one would do each.
    """
    with running(data_dir) as client:
        client.post("/v1/maps", json={"map": "campus"})
        halves = recording().scans[:24], recording().scans[24:]
        upload(client, "monday", Recording(halves[0]))
        upload(client, "alpha", Recording(halves[1]))  # before monday in the alphabet
        build(client, drives=["monday"], **PARAMETERS[encoding])
        alone = build(client, drives=["alpha"], **PARAMETERS[encoding])
        deleted = client.delete(f"/v1/maps/campus/revisions/{alone['revision']}")
        assert deleted.status_code == 204
        yield client


@pytest.fixture(scope="module")
def halves(tmp_path_factory, encoding):
    data_dir = tmp_path_factory.mktemp("halves") / "data"
    with two_halves(data_dir, encoding):
        return data_dir


@pytest.fixture
def campus(tmp_path, halves):
    """A copy of it, for a test that changes it."""
    with running(copy_of(halves, tmp_path / "data")) as client:
        yield client


@pytest.fixture(scope="module")
def settled(tmp_path_factory):
    """Such a map, harmonic, for tests that change nothing."""
    with two_halves(tmp_path_factory.mktemp("settled") / "data", "harmonic") as client:
        yield client


def test_a_vehicle_keeps_its_basis_when_a_drive_is_added(campus, encoding):
    held = basis_of(campus)
    etag = campus.get("/v1/maps/campus/basis").headers["ETag"]
    added = build(campus, base="live", add=["alpha"], make_live=True, force=True)
    assert added["revision"] != held.revision
    assert added["plan"]["drives"] == ["monday", "alpha"]
    kept_from = held.revision if encoding == "harmonic" else None
    assert added["plan"]["basis_kept_from"] == kept_from
    assert added["plan"]["parameters"]["base"] == held.revision
    record = revision_of(campus, added)
    assert record["live"]
    assert record["parameters"]["drives"] == ["monday", "alpha"]

    scan = recording(noise_seed=7).scans[6]
    signatures = held.encode(held.image(scan))
    for found in (
        localize(campus, "signature", content=pack_signatures(signatures), headers=PACKED),
        localize(campus, "signature", json=as_json(signatures)),
    ):
        assert found["revision"] == found["live_revision"] == added["revision"]
        assert (found["best"]["drive"], found["best"]["scan_index"]) == ("monday", 6)
    pinned = {**as_json(signatures), "revision": held.revision}
    del pinned["basis"]
    assert localize(campus, "signature", json=pinned)["revision"] == held.revision

    again = campus.get("/v1/maps/campus/basis", headers={"If-None-Match": etag})
    if encoding == "paper":  # it lacks the new drive's segments, and no more
        assert again.status_code == 200
        now = basis_of(campus)
        kept = now.elevation_basis[: len(held.segments)]
        assert kept.tobytes() == held.elevation_basis.tobytes()
        return
    assert (again.status_code, again.headers["ETag"]) == (304, etag)
    elsewhere = recording(noise_seed=7).scans[24 + 10]
    found = localize(campus, "signature", json=as_json(held.encode(held.image(elsewhere))))
    assert (found["best"]["drive"], found["best"]["scan_index"]) == ("alpha", 10)


def test_a_basis_is_downloaded_again_when_only_its_parameters_are_others(campus, encoding):
    if encoding == "paper":
        pytest.skip("the digests of the paper's bases are of their parameters, too")
    parameters = PARAMETERS["harmonic"] | {"views": "any"}  # bases of full views have a height
    build(campus, drives=["monday"], make_live=True, force=True, **parameters)
    first = campus.get("/v1/maps/campus/basis")
    sent = []

    def note(request, answer):
        if answer.status_code == 200 and request.method == "POST":
            sent.append(tuple(request.content[9:11]))

    scan = recording(noise_seed=7).scans[6].points_m
    with Vehicle(HERE, None, "campus", connections=watched(campus, note)) as vehicle:
        vehicle.locate(scan)
        others = {"ranks": [5, 9], "sensor_height_m": 2.5}
        build(campus, drives=["monday"], make_live=True, force=True, **parameters | others)
        asked = {"If-None-Match": first.headers["ETag"]}
        again = campus.get("/v1/maps/campus/basis", headers=asked)
        assert again.status_code == 200
        assert again.json()["basis"] == first.json()["basis"]
        assert others.items() <= again.json()["parameters"].items()
        for _ in range(2):
            vehicle.locate(scan)
    assert sent == [(6, 7), (6, 7), (5, 9)]
    rolled_back = {"revision": first.json()["revision"]}
    campus.put("/v1/maps/campus/live", json=rolled_back)
    assert campus.get("/v1/maps/campus/basis", headers=asked).status_code == 304


def test_a_basis_is_refitted_on_request_only_and_a_rollback_answers_the_old_one(campus, encoding):
    if encoding == "paper":
        pytest.skip("the paper's segments have bases of their own")
    held, first = basis_of(campus), campus.get("/v1/maps/campus").json()["live_revision"]
    signatures = as_json(held.encode(held.image(recording().scans[6])))
    plain = build(campus, **PARAMETERS["harmonic"])  # without base: all drives
    answer = revision_of(campus, plain)["parameters"]["basis"]
    assert (answer["digest"], answer["kept_from"]) == (held.digest, first)
    assert [fit["drive"] for fit in answer["fits"]] == ["alpha", "monday"]
    of_new, of_old = answer["fits"]
    assert of_new["kept_error"] > of_new["refitted_error"]
    assert of_old["kept_error"] < of_old["refitted_error"]  # it was fitted to that one alone

    refitted = build(campus, base="live", add=["alpha"], refit=True, make_live=True)
    answer = revision_of(campus, refitted)["parameters"]["basis"]
    assert answer["digest"] != held.digest
    assert (answer["kept_from"], answer["fits"]) == (None, [])
    found = localize(campus, "signature", json=signatures)
    assert found["revision"] == plain["revision"]  # the newest that has the basis
    assert found["live_revision"] == refitted["revision"]
    campus.delete(f"/v1/maps/campus/revisions/{plain['revision']}")
    assert localize(campus, "signature", json=signatures)["revision"] == first
    campus.delete(f"/v1/maps/campus/revisions/{first}")
    stale = campus.post("/v1/maps/campus/localizations/signature", json=signatures)
    assert problem_of(stale) == (409, "stale-signature")
    assert refitted["revision"] in stale.json()["detail"]


def test_removing_a_drive_leaves_it_stored_and_the_others_as_they_were(campus):
    both = build(campus, base="live", add=["alpha"], make_live=True, force=True)
    one = build(campus, base="live", remove=["alpha"])
    first = campus.get("/v1/maps/campus/revisions").json()["items"][-1]
    assert one["revision"] == first["revision"]  # the same content is the same revision
    assert campus.get("/v1/maps/campus/drives/alpha").json()["scans"] == 24
    other = revision_of(campus, build(campus, base=both["revision"], remove=["monday"]))
    assert other["parameters"]["drives"] == ["alpha"]
    assert other["parameters"]["segment_length"] == 8


def test_old_drives_are_left_out_when_an_age_is_given(campus, encoding):
    build(campus, base="live", add=["alpha"], make_live=True, force=True)
    with campus.service.store.catalog._database.writing() as session:
        monday = session.query(Drive).filter_by(slug="monday").one()
        monday.created_at = datetime.now(UTC) - timedelta(days=40)
    before = campus.get("/v1/maps/campus/drives").json()
    aged = revision_of(campus, build(campus, base="live", max_age_days=30))
    assert aged["parameters"]["drives"] == ["alpha"]
    young = revision_of(campus, build(campus, **PARAMETERS[encoding], max_age_days=50))
    assert young["parameters"]["drives"] == ["alpha", "monday"]
    assert campus.get("/v1/maps/campus/drives").json() == before
    nothing = campus.post(BUILDS, json={"drives": ["monday"], "max_age_days": 30})
    assert problem_of(nothing) == (422, "empty-drive")


@pytest.mark.parametrize(
    ("parameters", "problem"),
    [
        ({"add": ["alpha"]}, (422, "invalid-request")),
        ({"remove": ["monday"]}, (422, "invalid-request")),
        ({"base": "live"}, (422, "invalid-request")),
        ({"base": "newest", "add": ["alpha"]}, (422, "invalid-request")),
        ({"base": "live", "drives": ["alpha"]}, (422, "invalid-request")),
        ({"base": "live", "add": ["alpha"], "remove": ["alpha"]}, (422, "invalid-request")),
        ({"base": "live", "add": ["alpha", "alpha"]}, (422, "invalid-request")),
        ({"base": "live", "max_age_days": 0, "add": ["alpha"]}, (422, "invalid-request")),
        ({"base": "live", "add": ["nowhere"]}, (404, "drive-not-found")),
        ({"base": "live", "remove": ["alpha"]}, (404, "unknown-drive")),
        ({"base": "0" * 64, "add": ["alpha"]}, (404, "revision-not-found")),
        ({"base": "live", "remove": ["monday"]}, (422, "empty-drive")),
        ({"base": "live", "add": ["alpha"], "ranks": [4, 4]}, (422, "invalid-parameters")),
        ({"base": "live", "add": ["alpha"], "segments": 2}, (422, "invalid-parameters")),
    ],
)
def test_an_impossible_change_is_rejected_and_changes_nothing(settled, parameters, problem):
    before = whole_store(settled)
    assert problem_of(settled.post(BUILDS, json=parameters)) == problem
    assert whole_store(settled) == before


def test_a_base_without_a_change_is_rejected_with_how_to_read_a_drive_again(campus):
    refused = campus.post("/v1/maps/campus/builds", json={"base": "live"})
    assert "add (a drive that it has is read again)" in refused.json()["detail"]


def test_an_unknown_base_or_one_whose_drive_was_deleted_is_rejected(campus, tmp_path):
    with running(tmp_path / "other") as empty:
        empty.post("/v1/maps", json={"map": "campus"})
        none = empty.post(BUILDS, json={"base": "live", "add": ["alpha"]})
        assert problem_of(none) == (409, "no-live-revision")
    campus.delete("/v1/maps/campus/drives/monday")
    gone = campus.post(BUILDS, json={"base": "live", "add": ["alpha"]})
    assert problem_of(gone) == (404, "drive-not-found")
    for way_out in ("restore it from the recycle bin", "name it in remove"):
        assert way_out in gone.json()["detail"]
    build(campus, base="live", add=["alpha"], remove=["monday"])


def test_a_drive_of_a_base_that_was_restored_under_another_name_is_named_with_it(campus):
    campus.delete("/v1/maps/campus/drives/monday")
    [deleted] = campus.get("/v1/recycle-bin").json()["items"]
    campus.post(f"/v1/recycle-bin/{deleted['entry']}/restore?name=first")
    refused = campus.post(BUILDS, json={"base": "live", "add": ["alpha"]})
    assert problem_of(refused) == (404, "drive-not-found")
    assert "is named 'first' now: name that in add and 'monday' in remove" in refused.text
    job = build(campus, base="live", add=["alpha", "first"], remove=["monday"])
    assert job["plan"]["drives"][-2:] == ["alpha", "first"]


def test_another_recording_under_the_name_of_a_bases_drive_has_a_note(campus):
    campus.delete("/v1/maps/campus/drives/monday")
    upload(campus, "monday", Recording(recording().scans[:12]))
    job = build(campus, base="live", add=["alpha"])
    assert job["plan"]["drives"] == ["monday", "alpha"]
    note = "drive monday is another recording than the base's of that name"
    assert any(one.startswith(note) for one in job["notes"])
    job = build(campus, base="live", add=["monday"])
    assert not any(one.startswith(note) for one in job["notes"])


def test_a_damaged_live_revision_is_reported_and_refit_builds_without_it(campus, encoding):
    live = campus.get("/v1/maps/campus").json()["live_revision"]
    path = revision_file(campus.service.store, "campus", live)
    damage(path, b"no map at all")
    body = {"drives": ["alpha"], **PARAMETERS[encoding]}
    if encoding == "harmonic":
        refused = campus.post(BUILDS, json=body)
        assert problem_of(refused) == (500, "corrupt-file")
        for way_out in ("refit: true", "make a revision live whose file can be read"):
            assert way_out in refused.json()["detail"]
    build(campus, **body, refit=True)


def test_a_revision_from_before_bases_were_written_down_answers_while_it_is_live(campus):
    held = basis_of(campus)
    with campus.service.store.catalog._database.writing() as session:
        session.query(RevisionBasis).delete()
    signatures = as_json(held.encode(held.image(recording().scans[6])))
    assert localize(campus, "signature", json=signatures)["revision"] == held.revision
