"""Parts of captures that two requests send at the same time, and parts that are lost."""

import hashlib

import pytest

from core.progress import NO_PROGRESS
from storage.catalog import NewCapture
from storage.errors import CaptureMismatch
from storage.store import Store
from tests.support.new_catalog import put_new_catalog

PARTS = (b"a" * 16, b"b" * 16)


@pytest.fixture
def store(tmp_path):
    put_new_catalog(tmp_path / "catalog.sqlite3")
    with Store(tmp_path) as opened:
        opened.maps.create("campus")
        yield opened


def sent(store, files=(("a.bag", 32),), digest=None):
    """Return a capture whose parts are all stored."""
    new = NewCapture(drive="monday", files=files, part_bytes=16, digest=digest)
    capture, _ = store.captures.create("campus", new)
    for number in range(len(PARTS)):
        put(store, capture, number)
    return capture


def put(store, capture, number):
    return store.captures.put_part("campus", "monday", capture.id, number, PARTS[number])


def files(store, capture):
    return sorted(store.layout.capture(capture.map_id, capture.id).iterdir())


def test_a_lost_part_that_another_request_has_just_stored_again_stays(store, monkeypatch):
    capture = sent(store)
    files(store, capture)[1].unlink()
    forget = store.catalog.captures.forget_parts

    def forget_later(*which):
        monkeypatch.setattr(store.catalog.captures, "forget_parts", forget)
        assert put(store, capture, 1)[1]
        forget(*which)

    monkeypatch.setattr(store.catalog.captures, "forget_parts", forget_later)
    assert not put(store, capture, 1)[1]
    store.captures.complete("campus", "monday", capture.id)
    assert len(files(store, capture)) == 2
    whole = store.captures.get("campus", "monday", capture.id)
    with store.captures.files(whole, NO_PROGRESS) as folder:
        assert (folder / "a.bag").read_bytes() == b"".join(PARTS)


def test_all_lost_parts_are_forgotten_in_one_transaction(store, monkeypatch):
    capture = sent(store)
    for path in files(store, capture):
        path.unlink()
    commits = []
    monkeypatch.setattr(store.catalog._database, "require_writable", lambda: commits.append(1))
    assert store.captures.forget_lost() == 2
    assert store.captures.get("campus", "monday", capture.id).received == ()
    assert store.captures.forget_lost() == 0
    assert len(commits) == 1


def test_files_that_are_not_those_announced_are_not_read(store):
    digest = hashlib.sha256(b"".join(PARTS)).hexdigest()
    right = sent(store, (("a.bag", 12), ("empty.yaml", 0), ("b.bag", 20)), digest)
    with store.captures.files(right, NO_PROGRESS) as folder:
        found = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert found == {
        "a.bag": b"a" * 12,
        "empty.yaml": b"",
        "b.bag": b"a" * 4 + b"b" * 16,
    }
    wrong = sent(store, digest="0" * 64)
    with (
        pytest.raises(CaptureMismatch, match=digest),
        store.captures.files(wrong, NO_PROGRESS),
    ):
        pytest.fail("the files are read")
    assert len(files(store, wrong)) == 2  # and nothing of them is left over
