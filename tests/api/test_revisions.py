"""Revisions: which one answers, also a signature of another one."""

import pytest

from tests.support.campus import localize_packed, signed
from tests.support.map_files import revision_file
from tests.support.recording import KITTI, kitti, recording, upload_scan
from tests.support.service import problem_of, wait_for


def test_a_second_build_is_live_only_when_it_is_made_so(client, built):
    listed = client.get("/v1/maps/campus/revisions").json()["items"]
    assert [(item["revision"], item["live"]) for item in listed] == [
        (built.other, False),
        (built.live, True),
    ]
    assert client.get(f"/v1/jobs/{built.job}").json()["revision"] == built.live


def test_a_build_with_make_live_is_live_at_once(own, built):
    parameters = {"segments": 4, "views": "full", "make_live": True}
    job = own.post("/v1/maps/campus/builds", json=parameters).json()["job"]
    revision = wait_for(own, job)["revision"]
    assert own.get("/v1/maps/campus").json()["live_revision"] == revision != built.live


def test_a_newer_and_an_older_revision_can_be_made_live(own, built):
    def live_by_scan():
        answer = own.post(
            "/v1/maps/campus/localizations/scan", content=kitti(recording().scans[3]), headers=KITTI
        )
        return answer.json()["revision"]

    for revision in (built.other, built.live):
        made = own.put("/v1/maps/campus/live", json={"revision": revision[:12]})
        assert made.json()["live_revision"] == revision == live_by_scan()
        assert made.headers["ETag"] == own.get("/v1/maps/campus").headers["ETag"]


def test_who_makes_a_revision_live_gets_that_and_its_etag_though_another_follows(own, built):
    revisions = own.service.store.revisions
    set_live = revisions.set_live

    def followed(map_slug, digest, **options):
        made = set_live(map_slug, digest, **options)
        set_live(map_slug, built.live)
        return made

    revisions.set_live = followed
    before = int(own.get("/v1/maps/campus").headers["ETag"].strip('"'))
    made = own.put("/v1/maps/campus/live", json={"revision": built.other})
    assert made.json()["live_revision"] == built.other
    assert made.headers["ETag"] == f'"{before + 1}"'
    assert own.get("/v1/maps/campus").headers["ETag"] == f'"{before + 2}"'


def changed(content):
    """Return the bytes of a map's file with one changed in the middle, which is in an array."""
    at = len(content) // 2
    return content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :]


@pytest.mark.parametrize("anchor", [None, {"latitude_deg": 49.01, "longitude_deg": 8.4}])
@pytest.mark.parametrize(
    "damaged",
    [lambda _: b"", lambda _: None, changed],
    ids=["empty", "gone", "changed"],
)
def test_a_revision_whose_file_is_damaged_is_not_made_live(own, built, damaged, anchor):
    own.patch("/v1/maps/campus", json={"anchor": anchor}).raise_for_status()
    file = revision_file(own.service.store, "campus", built.other)
    content = damaged(file.read_bytes())
    file.unlink()  # it is linked to that of other tests
    if content is not None:
        file.write_bytes(content)
    refused = own.put("/v1/maps/campus/live", json={"revision": built.other})
    assert problem_of(refused) == (500, "corrupt-file")
    assert own.get("/v1/maps/campus").json()["live_revision"] == built.live


def test_an_older_version_of_the_map_is_refused_in_if_match(own, built):
    seen = own.get("/v1/maps/campus").headers["ETag"]
    own.patch("/v1/maps/campus", json={"description": "changed meanwhile"})
    refused = own.put(
        "/v1/maps/campus/live", json={"revision": built.other}, headers={"If-Match": seen}
    )
    assert problem_of(refused) == (412, "map-changed")
    assert own.get("/v1/maps/campus").json()["live_revision"] == built.live


def test_one_of_several_versions_of_the_map_may_be_named(own):
    seen = own.get("/v1/maps/campus").headers["ETag"]
    for if_match in ('"999", {}', 'W/{} ,\t"998"', "*"):
        if_match = if_match.format(seen)
        answer = own.patch(
            "/v1/maps/campus", json={"description": if_match}, headers={"If-Match": if_match}
        )
        assert answer.status_code == 200, answer.text
        seen = answer.headers["ETag"]
    refused = own.patch(
        "/v1/maps/campus", json={"description": "no"}, headers={"If-Match": '"998", "999"'}
    )
    assert problem_of(refused) == (412, "map-changed")
    assert "not 998 or 999" in refused.json()["detail"]
    for none in ("", '"1", 2', '"1", *', "x"):
        refused = own.delete("/v1/maps/campus", headers={"If-Match": none})
        assert problem_of(refused) == (422, "invalid-request")


def test_a_signature_of_a_retained_revision_is_answered_by_it_with_the_live_one_named(own, built):
    signature = signed(own, built.live)
    own.put("/v1/maps/campus/live", json={"revision": built.other})
    found = localize_packed(own, signature).json()
    assert (found["revision"], found["live_revision"]) == (built.live, built.other)
    assert found["best"]["scan_index"] == 20


def test_a_signature_of_a_deleted_revision_is_stale_with_the_live_one_named(own, built):
    signature = signed(own, built.other)
    assert localize_packed(own, signature).status_code == 200  # loaded, and forgotten all the same
    assert own.delete(f"/v1/maps/campus/revisions/{built.other}").status_code == 204
    refused = localize_packed(own, signature)
    assert problem_of(refused) == (409, "stale-signature")
    assert built.live in refused.json()["detail"]


def test_a_signature_of_another_map_is_stale(own, built):
    own.post("/v1/maps", json={"map": "harbour"})
    signature = signed(own, built.live)
    assert problem_of(localize_packed(own, signature, "harbour")) == (409, "no-live-revision")
    upload_scan(own, "harbour", "monday", 0, recording().scans[0])
    job = own.post("/v1/maps/harbour/builds", json={}).json()["job"]
    live = wait_for(own, job)["revision"]
    refused = localize_packed(own, signature, "harbour")
    assert problem_of(refused) == (409, "stale-signature")
    assert live in refused.json()["detail"]


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda body: body[:10], "invalid-signature"),
        (lambda body: body[:-1], "invalid-signature"),
        (lambda body: b"\x07" + body[1:], "invalid-signature"),
        (lambda body: body[:9] + b"\x05\x04" + body[11:], "invalid-signature"),
        (lambda body: body + body[11:], "invalid-signature"),
        (lambda body: body[:11] + b"\xff\xff" + body[13:], "unknown-segment"),
        (lambda body: body[:13] + b"\x00\x7c" + body[15:], "invalid-signature"),  # infinity
        (lambda body: b"", "empty-body"),
    ],
)
def test_an_impossible_packed_signature_is_refused_with_its_problem(client, built, change, problem):
    assert problem_of(localize_packed(client, change(signed(client, built.live)))) == (
        422,
        problem,
    )


@pytest.mark.parametrize(
    ("body", "problem"),
    [
        ({"revision": "xyz", "signatures": []}, "invalid-request"),
        ({"signatures": [{"segment": 0, "values": [[1]]}]}, "invalid-request"),
        ({"segment": 0, "values": [[1, 2], [3]]}, "invalid-signature"),
        ({"segment": 0, "values": [[1, 2], [3, 4]]}, "invalid-signature"),
        ({"segment": 0, "values": [[1e300] * 5] * 5}, "invalid-signature"),
        ({"segment": 0, "values": [[]]}, "invalid-signature"),
        ({"segment": 9, "values": [[1] * 5] * 5}, "unknown-segment"),
    ],
)
def test_an_impossible_json_signature_is_refused_with_its_problem(client, built, body, problem):
    if "signatures" not in body:
        body = {"revision": built.live, "signatures": [body]}
    response = client.post("/v1/maps/campus/localizations/signature", json=body)
    assert problem_of(response) == (422, problem)


def test_the_errors_of_a_json_signature_are_listed_by_field(client, built):
    body = {"revision": built.live, "signatures": [{"segment": -1, "values": [["a"]]}]}
    response = client.post("/v1/maps/campus/localizations/signature", json=body)
    assert [item["where"] for item in response.json()["errors"]] == [
        "body/signatures/0/segment",
        "body/signatures/0/values/0/0",
    ]


def test_the_live_revision_cannot_be_deleted(own, built):
    refused = own.delete(f"/v1/maps/campus/revisions/{built.live}")
    assert problem_of(refused) == (409, "revision-is-live")
    assert own.get(f"/v1/maps/campus/revisions/{built.live}/file").status_code == 200


def test_without_a_live_revision_nothing_is_answered(empty):
    scan = kitti(recording().scans[0])
    for response in (
        empty.post("/v1/maps/campus/localizations/scan", content=scan, headers=KITTI),
        empty.get("/v1/maps/campus/basis"),
        empty.get("/v1/maps/campus/topology"),
    ):
        assert problem_of(response) == (409, "no-live-revision")


@pytest.mark.parametrize("revision", ["0" * 64, "0" * 12, "zz", "%", "_" * 12, "é" * 20, "\x00"])
def test_a_revision_that_the_map_does_not_have_is_not_found(client, revision):
    for response in (
        client.get("/v1/maps/campus/basis", params={"revision": revision}),
        client.get("/v1/maps/campus/topology", params={"revision": revision}),
        client.put("/v1/maps/campus/live", json={"revision": revision}),
    ):
        assert problem_of(response) == (404, "revision-not-found")


def test_a_revision_is_downloaded(client, built):
    path = f"/v1/maps/campus/revisions/{built.live}/file"
    content = revision_file(client.service.store, "campus", built.live).read_bytes()
    whole = client.get(path)
    assert whole.content == content
    assert whole.headers["ETag"].startswith(f'"{built.live}-')
    assert built.live[:12] in whole.headers["Content-Disposition"]


@pytest.mark.parametrize(
    ("wanted", "parts"),
    [
        ("bytes=0-4", [(0, 5)]),
        ("bytes=-5", [(-5, None)]),
        ("BYTES = 10-", [(10, None)]),
        ("bytes=0-1,4-5", [(0, 2), (4, 6)]),
        ("bytes=0-1,999999999-", [(0, 2)]),
    ],
)
def test_a_part_of_a_file_is_downloaded(client, built, wanted, parts):
    path = f"/v1/maps/campus/revisions/{built.live}/file"
    content = revision_file(client.service.store, "campus", built.live).read_bytes()
    answer = client.get(path, headers={"Range": wanted})
    assert answer.status_code == 206
    pieces = [content[begin:end] for begin, end in parts]
    if len(pieces) == 1:
        assert answer.content == pieces[0]
    assert all(piece in answer.content for piece in pieces)


@pytest.mark.parametrize(
    "wanted", ["lines=0-1", "bytes=5-1", "bytes=0-1,5-1", "bytes=", "bytes=a-b", "0-4"]
)
def test_what_is_no_range_of_bytes_is_ignored(client, built, wanted):  # RFC 9110, section 14.2
    path = f"/v1/maps/campus/revisions/{built.live}/file"
    content = revision_file(client.service.store, "campus", built.live).read_bytes()
    answer = client.get(path, headers={"Range": wanted})
    assert (answer.status_code, answer.content) == (200, content)


def test_a_part_that_a_file_does_not_have_is_a_problem_with_its_length(client, built):
    path = f"/v1/maps/campus/revisions/{built.live}/file"
    size = len(client.get(path).content)
    for wanted in (f"bytes={size}-", "bytes=-0"):
        refused = client.get(path, headers={"Range": wanted})
        assert problem_of(refused) == (416, "range-not-satisfiable")
        assert refused.headers["Content-Range"] == f"bytes */{size}"
        other = {"Range": wanted, "If-Range": '"other"'}  # then the range is not wanted
        assert client.get(path, headers=other).status_code == 200


def test_a_file_that_a_client_has_is_not_sent_again(client, built):
    path = f"/v1/maps/campus/revisions/{built.live}/file"
    etag = client.get(path).headers["ETag"]
    for held in (etag, f'"other", W/{etag}', "*"):
        answer = client.get(path, headers={"If-None-Match": held, "Range": "bytes=0-1"})
        assert (answer.status_code, answer.content) == (304, b"")
        assert answer.headers["ETag"] == etag
    assert client.get(path, headers={"If-None-Match": '"other"'}).status_code == 200


def test_a_download_does_not_go_on_in_a_file_that_was_written_since(own, built):
    """An import has the digest of what it is made of, and another time inside its file."""
    path = f"/v1/maps/campus/revisions/{built.other}/file"
    whole = own.get(path)
    rest = {"Range": "bytes=1000-", "If-Range": whole.headers["ETag"]}
    resumed = own.get(path, headers=rest)
    assert (resumed.status_code, resumed.content) == (206, whole.content[1000:])
    own.delete(f"/v1/maps/campus/revisions/{built.other}").raise_for_status()
    heads = {"Content-Type": whole.headers["Content-Type"]}
    own.post("/v1/maps/campus/revisions", content=whole.content, headers=heads).raise_for_status()
    resumed = own.get(path, headers=rest)
    assert resumed.status_code == 200
    assert resumed.content != whole.content
    assert resumed.headers["ETag"] != whole.headers["ETag"]
    held = {"If-None-Match": whole.headers["ETag"]}
    assert own.get(path, headers=held).status_code == 200


def test_a_revision_that_is_deleted_during_its_download_arrives_whole(own, built, monkeypatch):
    store = own.service.store
    content = revision_file(store, "campus", built.other).read_bytes()
    really_open = store.revisions.open

    def open_and_delete(*args):
        opened = really_open(*args)
        store.revisions.delete("campus", built.other)
        return opened

    monkeypatch.setattr(store.revisions, "open", open_and_delete)
    path = f"/v1/maps/campus/revisions/{built.other}/file"
    assert own.get(path).content == content
    assert problem_of(own.get(path)) == (404, "revision-not-found")


def test_a_revision_that_is_deleted_before_it_is_opened_is_not_found(own, built, monkeypatch):
    revisions = own.service.store.revisions
    really_path = revisions.path_of

    def delete_first(record):
        monkeypatch.undo()
        revisions.delete("campus", built.other)
        return really_path(record)

    monkeypatch.setattr(revisions, "path_of", delete_first)
    refused = own.get(f"/v1/maps/campus/revisions/{built.other}/file")
    assert problem_of(refused) == (404, "revision-not-found")


def test_a_revision_without_its_file_is_a_corrupt_file(own, built):
    revision_file(own.service.store, "campus", built.other).unlink()
    refused = own.get(f"/v1/maps/campus/revisions/{built.other}/file")
    assert problem_of(refused) == (500, "corrupt-file")
