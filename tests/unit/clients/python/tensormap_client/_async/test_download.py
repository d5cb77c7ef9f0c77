"""Downloads in parts."""

import asyncio
import re

import httpx2
import pytest
from tensormap_client import Admin, AsyncAdmin, Rejected, Unreachable

OLD, NEW = b"0123456789", b"abcdefghijklm"


class Files:
    """A service whose file is another one from the n-th request on."""

    def __init__(self, changes_at=99):
        self.requests, self._changes_at = [], changes_at

    def __call__(self, request):
        self.requests.append(request)
        content = OLD if len(self.requests) < self._changes_at else NEW
        tag = f'"{content[:1].decode()}"'
        if request.headers.get("If-Range", tag) != tag:
            return httpx2.Response(200, content=content, headers={"ETag": tag})
        first, last = map(int, re.findall(r"\d+", request.headers["Range"]))
        part = content[first : last + 1]
        where = f"bytes {first}-{first + len(part) - 1}/{len(content)}"
        return httpx2.Response(206, content=part, headers={"ETag": tag, "Content-Range": where})


@pytest.fixture(autouse=True)
def _small_parts(monkeypatch):
    monkeypatch.setattr("tensormap_client._sync.download._PART_BYTES", 4)


def downloaded(service, file):
    with Admin("http://maps.example", connections=httpx2.MockTransport(service)) as admin:
        admin.download_revision("campus", "1f", file)


def test_a_file_arrives_in_parts_and_takes_the_place_of_another(tmp_path):
    file, service = tmp_path / "campus.h5", Files()
    file.write_bytes(b"another, which is longer")
    downloaded(service, file)
    assert file.read_bytes() == OLD
    assert len(service.requests) == 3
    assert list(tmp_path.iterdir()) == [file]


def test_a_file_that_changes_meanwhile_is_downloaded_anew(tmp_path):
    downloaded(Files(changes_at=2), tmp_path / "campus.h5")
    assert (tmp_path / "campus.h5").read_bytes() == NEW


def test_a_lost_connection_costs_one_part(tmp_path):
    files, lost = Files(), iter([False, True, False, False])

    def service(request):
        if next(lost):
            raise httpx2.ReadError("connection reset")
        return files(request)

    downloaded(service, tmp_path / "campus.h5")
    assert (tmp_path / "campus.h5").read_bytes() == OLD
    asked = [request.headers["Range"] for request in files.requests]
    assert asked == ["bytes=0-3", "bytes=4-7", "bytes=8-11"]


@pytest.mark.parametrize(
    ("answer", "error"),
    [
        (httpx2.Response(404, json={}), Rejected),
        (httpx2.Response(206, content=b"x", headers={"Content-Range": "bytes 7-7/9"}), Unreachable),
        (httpx2.Response(206, content=b"x"), Unreachable),
        (
            httpx2.Response(206, content=b"", headers={"Content-Range": "bytes 0-3/9"}),
            Unreachable,
        ),
    ],
)
def test_a_failed_download_leaves_what_was_there(tmp_path, answer, error):
    (tmp_path / "campus.h5").write_bytes(b"before")
    with pytest.raises(error):
        downloaded(lambda _: answer, tmp_path / "campus.h5")
    [file] = tmp_path.iterdir()
    assert file.read_bytes() == b"before"


def test_parts_of_two_files_are_not_joined_where_a_cache_ignores_if_range(tmp_path):
    files = Files(changes_at=2)

    def service(request):
        request.headers.pop("If-Range", None)
        return files(request)

    with pytest.raises(Unreachable, match="the file changed during the download"):
        downloaded(service, tmp_path / "campus.h5")
    assert list(tmp_path.iterdir()) == []


def test_two_downloads_to_one_name_leave_one_whole_file(tmp_path):
    file, first = tmp_path / "campus.h5", Files()

    def service(request):
        if len(first.requests) == 1:  # between two parts of it, another one
            first.requests.append(request)
            downloaded(Files(changes_at=0), file)
            assert file.read_bytes() == NEW
            first.requests.pop()
        return first(request)

    downloaded(service, file)
    assert file.read_bytes() == OLD
    assert list(tmp_path.iterdir()) == [file]


def test_a_cancelled_download_leaves_no_file(tmp_path, monkeypatch):
    monkeypatch.setattr("tensormap_client._async.download._PART_BYTES", 4)
    files = Files()

    async def service(request):
        if files.requests:
            await asyncio.sleep(60.0)
        return files(request)

    async def run():
        connections = httpx2.MockTransport(service)
        async with AsyncAdmin("http://maps.example", connections=connections) as admin:
            await admin.download_revision("campus", "1f", tmp_path / "campus.h5")

    with pytest.raises(TimeoutError):
        asyncio.run(asyncio.wait_for(run(), 0.5))
    assert list(tmp_path.iterdir()) == []
