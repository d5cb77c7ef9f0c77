"""Queries of long tables go through an index, on SQLite, which has no statistics of its tables."""

from datetime import UTC, datetime

import pytest

from storage.catalog import Act, Catalog, NewCapture
from tests.support.catalog_queries import plans
from tests.support.catalog_rows import add_scans
from tests.support.new_catalog import put_new_catalog

NOW = datetime(2026, 1, 1, tzinfo=UTC)


@pytest.fixture
def catalog(tmp_path):
    put_new_catalog(tmp_path / "catalog.sqlite3")
    opened = Catalog(f"sqlite:///{tmp_path / 'catalog.sqlite3'}")
    yield opened
    opened.close()


@pytest.mark.parametrize(
    ("chosen", "index"),
    [
        ({"key_id": "ab12"}, "ix_audit_key_id_seq (key_id=? AND seq>?)"),
        ({"map_slug": "campus"}, "ix_audit_map_slug_seq (map_slug=? AND seq>?)"),
        ({"since": NOW}, "ix_audit_at_seq (at>?)"),
    ],
)
def test_a_page_of_the_audit_log_takes_its_own_entries_in_their_order(catalog, chosen, index):
    steps = plans(catalog, lambda: catalog.audit.list(1, **chosen))
    first = plans(catalog, lambda: catalog.audit.list(**chosen))
    assert index in " ".join(first)
    assert not [step for step in steps + first if "TEMP B-TREE" in step or "SCAN" in step]
    assert len(steps) == 1


@pytest.mark.parametrize(
    ("chosen", "index"),
    [
        ({}, "sqlite_autoindex_audit_1 (seq<?)"),
        ({"key_id": "ab12"}, "ix_audit_key_id_seq (key_id=? AND seq<?)"),
        ({"map_slug": "campus"}, "ix_audit_map_slug_seq (map_slug=? AND seq<?)"),
        ({"since": NOW}, "ix_audit_at_seq (at>?)"),
        ({"since": NOW}, "sqlite_autoindex_audit_1 (seq>? AND seq<?)"),
        ({"until": NOW}, "ix_audit_at_seq (at<?)"),
        ({"actions": ["build"]}, "ix_audit_action_seq (action=? AND seq<?)"),
    ],
)
def test_so_does_a_page_that_begins_with_the_newest(catalog, chosen, index):
    first = plans(catalog, lambda: catalog.audit.list(newest_first=True, **chosen))
    assert index in " ".join(first)
    assert not [step for step in first if "TEMP B-TREE" in step or "SCAN audit" in step]


@pytest.mark.parametrize("newest_first", [False, True])
def test_several_actions_of_the_audit_log_are_several_ranges_of_an_index(catalog, newest_first):
    def page():
        chosen = {"actions": ["build", "make_live"], "newest_first": newest_first}
        return catalog.audit.list(7, **chosen)

    steps = plans(catalog, page)
    index = f"ix_audit_action_seq (action=? AND seq{'<' if newest_first else '>'}?)"
    assert sum(index in step for step in steps) == 2
    assert not [step for step in steps if "TEMP B-TREE" in step or "SCAN audit" in step]


def test_an_entry_before_a_clock_was_set_back_is_of_its_time(catalog, monkeypatch):
    times = [datetime(2026, 1, day, tzinfo=UTC) for day in (1, 5, 2, 3, 6)]
    for number, at in enumerate(times, 1):
        catalog.audit.append(Act("ab12", "make", f"/v1/{number}"), "done")
        with catalog._database.engine.begin() as connection:
            change = f"UPDATE audit SET at = '{at:%Y-%m-%d %H:%M:%S.%f}' WHERE seq = {number}"
            connection.exec_driver_sql(change)
    for since, expected in ((2, [2, 3, 4, 5]), (3, [2, 4, 5]), (6, [5]), (7, [])):
        chosen = catalog.audit.list(since=datetime(2026, 1, since, tzinfo=UTC))
        assert [entry.seq for entry in chosen.items] == expected


def test_the_tokens_of_a_key_are_counted_in_their_index(catalog):
    def add():
        catalog.tokens.add("t", "secret", "key", ["read"], None, datetime.now(UTC), most=1)

    assert "ix_tokens_key_hash_expires_at (key_hash=?)" in " ".join(plans(catalog, add))


def test_the_scans_of_a_file_are_found_without_the_others_of_the_drive(catalog):
    catalog.maps.create("campus")
    drive_id = add_scans(catalog, "campus", "monday", range(3)).drive_id
    chunk = catalog.scans.get(drive_id, 0).chunk
    [step] = plans(catalog, lambda: catalog.scans.of_chunk(drive_id, chunk))
    assert "ix_scans_drive_id_chunk (drive_id=? AND chunk=?)" in step


@pytest.mark.parametrize(
    ("drive", "after", "index"),
    [
        (None, "", "ix_captures_map_id_created_at_id (map_id=?)"),
        (None, "1-a", "ix_captures_map_id_created_at_id (map_id=? AND (created_at,id)<(?,?))"),
        ("dock", "", "ix_captures_map_id_drive_created_at_id (map_id=? AND drive=?)"),
        (
            "dock",
            "1-a",
            "ix_captures_map_id_drive_created_at_id"
            " (map_id=? AND drive=? AND (created_at,id)<(?,?))",
        ),
    ],
)
def test_a_page_of_captures_takes_its_own_in_their_order(catalog, drive, after, index):
    catalog.maps.create("campus")
    steps = plans(catalog, lambda: catalog.captures.list("campus", drive, after))
    assert index in " ".join(steps)
    assert not [
        step for step in steps if "TEMP B-TREE FOR ORDER" in step or "SCAN captures" in step
    ]


def test_a_capture_is_found_again_among_those_of_its_drive(catalog):
    catalog.maps.create("campus")
    new = NewCapture("dock", (("a.bag", 9),), 9, digest=64 * "0")
    steps = plans(catalog, lambda: catalog.captures.has_same("campus", new))
    of_captures = "ix_captures_map_id_drive_created_at_id (map_id=? AND drive=?)"
    assert of_captures in " ".join(steps)


def test_a_batch_of_a_purge_takes_its_scans_from_their_index(catalog):
    catalog.maps.create("campus")
    add_scans(catalog, "campus", "monday", range(9))
    catalog.recycle_bin.put_map("campus", purging=True)
    [purge] = catalog.purges.begun()
    steps = plans(catalog, lambda: catalog.purges.remove_some(purge, rows=4))
    of_scans = [step for step in steps if "scans" in step]
    assert all("(drive_id=?" in step for step in of_scans)
    assert "(drive_id=? AND scan_index<?)" in " ".join(of_scans)
    assert not [step for step in steps if step.startswith("SCAN") or "TEMP B-TREE" in step]
