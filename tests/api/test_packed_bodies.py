"""Compressed bodies, and bodies with a digest."""

import base64
import gzip
import hashlib

import pytest
import zstandard

from tests.support.recording import KITTI, TAR, kitti, npy, recording, tar
from tests.support.service import problem_of, running, whole_store

SCANS = recording(scans=6).scans
DRIVE = "/v1/maps/campus/drives/monday"
FILES = [(f"{index:06}.npy", npy(scan.points_m)) for index, scan in enumerate(SCANS)]
ARCHIVE = tar(FILES[1:3])
STORED = [{"first": 1, "last": 2}]
PACKED = {
    "gzip": gzip.compress,
    "x-gzip": gzip.compress,
    "zstd": zstandard.ZstdCompressor(write_checksum=True).compress,
}


@pytest.fixture
def empty(emptied):
    return emptied


def digest(body, algorithm="sha256"):
    value = base64.b64encode(hashlib.new(algorithm, body).digest()).decode()
    return {"Content-Digest": f"{algorithm[:3]}-{algorithm[3:]}=:{value}:"}


@pytest.mark.parametrize("encoding", PACKED)
@pytest.mark.parametrize("members", [1, 2])
def test_a_packed_body_is_the_body(empty, encoding, members):
    body = kitti(SCANS[0])
    parts = [body] if members == 1 else [body[:1000], body[1000:]]
    packed = b"".join(PACKED[encoding](part) for part in parts)
    headers = {**KITTI, "Content-Encoding": encoding, **digest(packed)}
    put = empty.put(f"{DRIVE}/scans/0", content=packed, headers=headers)
    assert put.status_code == 201
    plain = empty.put(f"{DRIVE}/scans/0", content=body, headers=KITTI)
    assert (plain.status_code, plain.json()) == (200, put.json())
    archive = PACKED[encoding](ARCHIVE)
    pieces = (archive[at : at + 777] for at in range(0, len(archive), 777))
    answer = empty.post(
        f"{DRIVE}/scans", content=pieces, headers={**TAR, "Content-Encoding": encoding}
    ).json()
    assert answer["stored"] == STORED
    poses = PACKED[encoding](b'{"poses": [{"scan": 0, "timestamp_s": 7.5}]}')
    headers = {"Content-Type": "application/json", "Content-Encoding": encoding}
    assert empty.put(f"{DRIVE}/poses", content=poses, headers=headers).status_code == 200


@pytest.mark.parametrize("encoding", ["gzip", "zstd"])
def test_a_body_that_does_not_unpack_is_refused_and_changes_nothing(empty, encoding):
    before = whole_store(empty)
    whole = PACKED[encoding](kitti(SCANS[0]))
    headers = {**KITTI, "Content-Encoding": encoding}
    for body in (b"", b"hello", whole[:-3], whole[:9], whole[:500] + bytes(50) + whole[550:]):
        refused = empty.put(f"{DRIVE}/scans/0", content=body, headers=headers)
        assert problem_of(refused)[0] in {400, 422}
        if body != b"":
            assert problem_of(refused) == (400, "malformed-body")
    json_headers = {"Content-Type": "application/json", "Content-Encoding": encoding}
    refused = empty.put(f"{DRIVE}/poses", content=b"hello", headers=json_headers)
    assert problem_of(refused) == (400, "malformed-body")
    assert whole_store(empty) == before


@pytest.mark.parametrize("encoding", ["gzip", "zstd"])
def test_a_bomb_is_stopped_at_the_cap(tmp_path, encoding):
    with running(tmp_path / "data", max_decoded_bytes=100_000) as client:
        client.post("/v1/maps", json={"map": "campus"})
        bomb = PACKED[encoding](bytes(30_000_000))
        assert len(bomb) < 50_000
        headers = {**KITTI, "Content-Encoding": encoding}
        refused = client.put(f"{DRIVE}/scans/0", content=bomb, headers=headers)
        assert problem_of(refused) == (413, "body-too-large")
        assert "unpacks to more than the 100000 bytes" in refused.json()["detail"]
        headers = {"Content-Type": "application/json", "Content-Encoding": encoding}
        refused = client.put(f"{DRIVE}/poses", content=bomb, headers=headers)
        assert problem_of(refused) == (413, "body-too-large")


@pytest.mark.parametrize("encoding", ["br", "gzip, gzip", "zip"])
def test_an_encoding_that_is_unknown_is_refused(empty, encoding):
    headers = {**KITTI, "Content-Encoding": encoding}
    refused = empty.put(f"{DRIVE}/scans/0", content=kitti(SCANS[0]), headers=headers)
    assert problem_of(refused) == (415, "unsupported-body")


@pytest.mark.parametrize("algorithm", ["sha256", "sha512"])
def test_a_body_with_the_right_digest_is_accepted(empty, algorithm):
    body = kitti(SCANS[0])
    put = empty.put(f"{DRIVE}/scans/0", content=body, headers={**KITTI, **digest(body, algorithm)})
    assert put.status_code == 201
    headers = {**TAR, **digest(ARCHIVE, algorithm)}
    answer = empty.post(f"{DRIVE}/scans", content=ARCHIVE, headers=headers).json()
    assert answer["stored"] == STORED


@pytest.mark.parametrize(
    "content_digest",
    [digest(b"another")["Content-Digest"], "sha-256=:A:", "sha-256", "sha-256=:====:", "x"],
)
def test_a_body_with_another_digest_is_rejected_and_changes_nothing(empty, content_digest):
    before = whole_store(empty)
    headers = {"Content-Digest": content_digest}
    put = empty.put(f"{DRIVE}/scans/0", content=kitti(SCANS[0]), headers={**KITTI, **headers})
    post = empty.post(f"{DRIVE}/scans", content=ARCHIVE, headers={**TAR, **headers})
    poses = empty.put(f"{DRIVE}/poses", json={"poses": [{"scan": 0}]}, headers=headers)
    for refused in (put, post, poses):
        assert problem_of(refused) == (400, "digest-mismatch")
    assert whole_store(empty) == before


def test_a_digest_of_an_unknown_algorithm_is_ignored(empty):
    headers = {**KITTI, "Content-Digest": "md5=:AAAA:"}
    put = empty.put(f"{DRIVE}/scans/0", content=kitti(SCANS[0]), headers=headers)
    assert put.status_code == 201


@pytest.mark.parametrize("encoding", ["gzip", "zstd"])
@pytest.mark.parametrize("share", [0.01, 0.5, 0.9])
def test_a_packed_archive_that_breaks_off_reports_how_many_scans_were_stored(
    empty, encoding, share
):
    packed = PACKED[encoding](tar(FILES))
    headers = {**TAR, "Content-Encoding": encoding}
    cut = packed[: int(share * len(packed))]
    refused = empty.post(f"{DRIVE}/scans", content=cut, headers=headers)
    assert problem_of(refused) == (400, "malformed-body")
    drive = empty.get(DRIVE)
    stored = drive.json()["scans"] if drive.status_code == 200 else 0
    assert (stored > 0) is (share > 0.1)
    assert f"; {stored} scans stored before, 0 there already, 0 skipped" in refused.json()["detail"]
