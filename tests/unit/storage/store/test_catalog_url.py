"""Where SQLite finds a catalog: in the data directory, whatever characters its path has."""

import os

import pytest

from storage.backup.backup import write_backup
from storage.store import Store

ODD = pytest.mark.parametrize("name", ["a b", "a?b", "a?mode=memory", "a%20b", "100%", "a#b", "ä"])


@ODD
def test_a_catalog_and_its_tracks_are_in_their_directory_of_any_name(tmp_path, name):
    with Store(tmp_path / name) as made:
        made.maps.create("campus")
        made.saved_tracks().close()
        assert made.layout.catalog.stat().st_size
        assert made.layout.tracks.stat().st_size
    assert [path.name for path in tmp_path.iterdir()] == [name]
    write_backup(tmp_path / name, tmp_path / "b.tar")


@ODD
def test_a_directory_of_any_name_that_cannot_be_written_is_read(tmp_path, monkeypatch, name):
    with Store(tmp_path / name) as made:
        made.maps.create("campus")
    monkeypatch.setattr(os, "access", lambda *_: False)
    with Store(tmp_path / name) as opened:
        assert [found.slug for found in opened.maps.list().items] == ["campus"]
