"""What every database of saved tracks promises."""

import os
import sqlite3
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime

import pytest
from sqlalchemy.exc import IntegrityError

from storage.catalog import NotKept, SavedTrack, SavedTracks, database
from storage.catalog.kept import Kept
from storage.errors import StorageUnavailable, with_cause

NOW = datetime(2026, 11, 23, tzinfo=UTC)


def track(name="a", *, used_s=100.0, **given):
    return SavedTrack(name, "m", "k", "f" * 64, NOW, used_s, **given)


@pytest.fixture
def saved(database_url):
    opened = SavedTracks(database_url, Kept())
    yield opened
    opened.close()


@pytest.fixture
def other(database_url, saved):
    """Of another process on the same database."""
    opened = SavedTracks(database_url, Kept())
    yield opened
    opened.close()


def test_a_track_is_returned_as_it_was_saved(saved, other):
    first = track()
    saved.add(first, 0.0)
    assert other.get("a") == first
    observed = track(observed_s=1.5, observations=2, state={"places": [[1, 0.5]]}, last={"x": None})
    assert saved.update([(0, observed)]) == set()
    assert other.get("a") == observed
    saved.remove("a")
    assert other.get("a") is None


def test_of_two_processes_that_go_on_with_a_track_the_second_notices(saved, other):
    for name in "abc":
        saved.add(track(name), 0.0)
    assert other.update([(0, track("a", observations=3))]) == set()
    other.remove("b")
    now = [(0, track(name, observations=2, used_s=101.0)) for name in "abc"]
    assert saved.update(now) == {"a", "b"}
    assert [saved.get(name) for name in "ab"] == [track("a", observations=3), None]
    assert saved.get("c") == now[2][1]


def test_idle_tracks_are_not_returned_and_removed_when_one_is_added(saved):
    saved.add(track("a", used_s=10.0), 0.0)
    saved.add(track("b", used_s=20.0), 0.0)
    assert [found.id for found in saved.used_since(15.0)] == ["b"]
    assert [found.id for found in saved.page("m", "", 9, used_since_s=15.0).items] == ["b"]
    saved.add(track("c", used_s=30.0), 20.0)
    assert (saved.get("a"), saved.get("b")) == (None, track("b", used_s=20.0))


def test_a_track_takes_the_place_of_another_one_or_changes_nothing(saved):
    for name in "ab":
        saved.add(track(name), 0.0)
    with pytest.raises(IntegrityError):
        saved.add(track("b"), 0.0, {"a"})
    assert {found.id for found in saved.used_since(0.0)} == {"a", "b"}
    saved.add(track("c"), 0.0, {"a"})
    assert {found.id for found in saved.used_since(0.0)} == {"b", "c"}


def test_pages_are_of_one_map_and_of_one_key_if_given(saved):
    for name in "abcd":
        saved.add(track(name), 0.0)
    saved.add(replace(track("x"), map_id="other"), 0.0)
    saved.add(replace(track("y"), key_id="other"), 0.0)
    page = saved.page("m", "", 3, used_since_s=0.0)
    assert [found.id for found in page.items] == ["a", "b", "c"]
    saved.remove("c")  # the cursor need not be there
    page = saved.page("m", page.next_after, 3, used_since_s=0.0)
    assert ([found.id for found in page.items], page.next_after) == (["d", "y"], None)
    of_key = saved.page("m", "", 9, used_since_s=0.0, key_id="other")
    assert [found.id for found in of_key.items] == ["y"]


def test_no_query_is_made_where_the_catalog_forbids_it(database_url):
    kept = Kept()
    saved = SavedTracks(database_url, kept)
    with kept.only():
        for query in (lambda: saved.get("a"), lambda: saved.remove("a")):
            with pytest.raises(NotKept):
                query()
    saved.close()


def test_processes_that_start_at_once_share_one_table(database_url):
    with ThreadPoolExecutor(4) as pool:
        opened = list(pool.map(lambda _: SavedTracks(database_url, Kept()), range(4)))
    for number, saved in enumerate(opened):
        saved.add(track(str(number)), 0.0)
    assert len(opened[0].used_since(0.0)) == 4
    for saved in opened:
        saved.close()


@pytest.fixture
def tracks_file(tmp_path):
    """A SQLite file with one track."""
    file = tmp_path / "tracks"
    saved = SavedTracks(f"sqlite:///{file}", Kept())
    saved.add(track(), 0.0)
    saved.close()
    return file


def test_a_file_of_tracks_is_readable_by_this_user_only_whatever_the_umask(tmp_path):
    before = os.umask(0)
    try:
        saved = SavedTracks(f"sqlite:///{tmp_path}/tracks", Kept())
        saved.add(track(), 0.0)
        modes = {file.name: file.stat().st_mode & 0o077 for file in tmp_path.iterdir()}
        saved.close()
    finally:
        os.umask(before)
    assert "tracks" in modes
    assert set(modes.values()) == {0}


def test_a_damaged_file_of_tracks_is_set_aside(tracks_file, caplog):
    whole = tracks_file.read_bytes()
    for damaged in (b"no database" * 1000, whole[:4096] + bytes(len(whole) - 4096), whole[:5000]):
        tracks_file.write_bytes(damaged)
        saved = SavedTracks(f"sqlite:///{tracks_file}", Kept())
        assert saved.used_since(0.0) == ()
        saved.close()
        assert "is damaged and is set aside" in caplog.text
        aside = tracks_file.with_name("tracks.damaged")
        assert aside.read_bytes() == damaged
        assert {file.name for file in tracks_file.parent.iterdir()} == {"tracks", "tracks.damaged"}


def test_a_file_of_tracks_that_cannot_be_read_now_stays(tracks_file, monkeypatch):
    error = sqlite3.OperationalError("disk I/O error")
    error.sqlite_errorcode = sqlite3.SQLITE_IOERR_READ

    def failing(self):
        with database._named_errors():
            raise error

    with monkeypatch.context() as patched:
        patched.setattr(database.Database, "reading", failing)
        with pytest.raises(StorageUnavailable) as failed:
            SavedTracks(f"sqlite:///{tracks_file}", Kept())
        assert "disk I/O error" in with_cause(failed.value)
    saved = SavedTracks(f"sqlite:///{tracks_file}", Kept())
    assert [found.id for found in saved.used_since(0.0)] == ["a"]
    saved.close()
