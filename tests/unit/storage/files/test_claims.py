"""What may be removed as abandoned: nothing that is in use, another user's, or elsewhere."""

import os

import pytest

from storage.files.claims import claimed, remove_abandoned


@pytest.fixture(params=["file", "folder"])
def left(request, tmp_path):
    path = tmp_path / "left.part"
    if request.param == "folder":
        (path / "maps").mkdir(parents=True)
    else:
        path.write_bytes(b"half")
    return path


def test_what_is_claimed_is_removed_only_after_that(left):
    with claimed(left):
        assert not remove_abandoned(left)
        assert left.exists()
    assert remove_abandoned(left)
    assert not left.exists()


def test_what_is_another_users_stays(left, monkeypatch):
    monkeypatch.setattr(os, "geteuid", lambda: left.stat().st_uid + 1)
    assert not remove_abandoned(left)
    assert left.exists()


def test_a_link_stays_and_so_does_what_it_leads_to(left):
    link = left.with_name("link.part")
    link.symlink_to(left)
    assert not remove_abandoned(link)
    assert link.is_symlink()
    assert left.exists()


def test_nothing_is_removed_where_nothing_is(tmp_path):
    assert not remove_abandoned(tmp_path / "left.part")
