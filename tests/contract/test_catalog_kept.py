"""What the catalog keeps in memory, and when it is read again."""

import dataclasses
import subprocess
import sys
import time
from datetime import UTC, datetime, timedelta

import pytest

from storage.catalog import Catalog, NotKept
from storage.errors import MapNotFound
from tests.support.catalog_rows import FACTS, add_scans
from tests.support.purges import purge_map

SECRET_HASH = "0f" * 32
DIGEST = "0123456789abcdef" * 4
SEEN_S = 1.0
# A process that revokes the key whose id it is given.
REVOKE = """
import sys
from storage.catalog import Catalog
from tests.support.purges import purge_map
catalog = Catalog(sys.argv[1])
catalog.keys.revoke(sys.argv[2])
catalog.close()
"""


def watch(catalog):
    """Return when what is read of its map is kept."""
    catalog.watch()
    ends_s = time.monotonic() + 30
    while time.monotonic() < ends_s:
        catalog.maps.get("campus")
        try:
            with catalog.kept_only():
                catalog.maps.get("campus")
        except NotKept:
            time.sleep(0.05)  # PostgreSQL's channel is being opened
        else:
            return
    raise AssertionError("nothing is ever kept")


@pytest.fixture
def watched(catalog):
    """A catalog of one map that keeps what it reads."""
    catalog.maps.create("campus")
    watch(catalog)
    return catalog


def test_without_watching_nothing_is_kept(catalog):
    catalog.maps.create("campus")
    catalog.maps.get("campus")
    with pytest.raises(NotKept), catalog.kept_only():
        catalog.maps.get("campus")
    assert catalog.maps.get("campus").slug == "campus"  # the block has ended


def test_an_unknown_basis_is_not_kept(watched):
    for _ in range(2):
        assert watched.map_summaries.with_basis("0" * 64) == frozenset()
        with pytest.raises(NotKept), watched.kept_only():
            watched.map_summaries.with_basis("0" * 64)


SPELLINGS = {
    spelt
    for end in range(12, 65, 4)
    for spelt in (DIGEST[:end], DIGEST[:end].upper(), DIGEST[: end - 1] + DIGEST[end - 1].upper())
}


@pytest.mark.parametrize(
    ("get", "found"),
    [
        (lambda catalog, name: catalog.revisions.get("campus", name).digest, DIGEST),
        (lambda catalog, name: catalog.revisions.with_basis("campus", name).digest, DIGEST),
        (lambda catalog, name: len(catalog.map_summaries.with_basis(name)), 1),
        (lambda catalog, name: catalog.bases.get(name).name, "city"),
    ],
    ids=["revision", "of a basis", "maps of a basis", "shared basis"],
)
def test_spellings_of_one_digest_do_not_fill_the_memory(catalog, get, found):
    facts = dataclasses.replace(FACTS, bases=(DIGEST,))
    catalog.revisions.add(catalog.maps.create("campus").id, DIGEST, "a.h5", 10, facts)
    catalog.bases.add("city", DIGEST, "c.h5", "harmonic", 800)
    watch(catalog)
    kept = catalog._database.kept
    before = len(kept._of[1])
    for name in sorted(SPELLINGS):
        assert get(catalog, name) == found
    assert len(kept._of[1]) == before + 2
    with catalog.kept_only():  # as a whole, and as much of it as packed signatures carry
        for name in (DIGEST, DIGEST.upper(), DIGEST[:16], DIGEST[:16].upper()):
            assert get(catalog, name) == found


def test_a_shared_basis_is_kept_by_its_name(catalog):
    catalog.maps.create("campus")
    catalog.bases.add("city", DIGEST, "c.h5", "harmonic", 800)
    watch(catalog)
    catalog.bases.get("city")
    with catalog.kept_only():
        assert catalog.bases.get("city").digest == DIGEST


def test_what_was_read_is_not_read_again(watched):
    key = watched.keys.add(SECRET_HASH, ["localize"])
    for _ in range(2):
        assert watched.keys.with_hash(SECRET_HASH).id == key.id
        assert watched.keys.ever_made()
        watched.maps.get("campus")
    with watched.kept_only():
        assert watched.keys.with_hash(SECRET_HASH).id == key.id
        assert watched.keys.ever_made()
        assert watched.maps.get("campus").slug == "campus"


def test_a_change_of_this_process_holds_at_once(watched):
    key = watched.keys.add(SECRET_HASH, ["localize"])
    for _ in range(20):
        assert watched.keys.with_hash(SECRET_HASH).revoked_at is None
        watched.maps.update("campus", description="a")
        assert watched.maps.get("campus").description == "a"
        watched.maps.update("campus", description="b")
        assert watched.maps.get("campus").description == "b"
    watched.keys.revoke(key.id)
    assert watched.keys.with_hash(SECRET_HASH).revoked_at is not None
    purge_map(watched, "campus")
    with pytest.raises(MapNotFound):
        watched.maps.get("campus")


def test_scans_that_are_stored_discard_nothing(watched):
    add_scans(watched, "campus", "monday", [0, 1])
    watched.maps.get("campus")
    with watched.kept_only():
        watched.maps.get("campus")
    add_scans(watched, "campus", "monday", [2, 3], "two.h5")
    with watched.kept_only():
        assert watched.maps.get("campus").slug == "campus"
    watched.maps.update("campus", description="changed")
    assert watched.maps.get("campus").description == "changed"


def test_a_new_token_discards_nothing_and_is_found_at_once(watched):
    key = watched.keys.add(SECRET_HASH, ["localize"])
    ends = datetime.now(UTC) + timedelta(hours=1)
    for number in range(20):
        watched.maps.get("campus")
        found_by = f"of token {number}"
        assert watched.tokens.with_hash(found_by) is None
        limits = (["localize"], None, ends)
        token = watched.tokens.add(f"t{number}", found_by, SECRET_HASH, *limits, most=20)
        try:
            with watched.kept_only():
                watched.maps.get("campus")
            break
        except NotKept:
            time.sleep(0.05)  # PostgreSQL announces the new key a little later
    else:
        raise AssertionError("each new token discarded what was kept")
    assert watched.tokens.with_hash(found_by) == (token, key)
    watched.keys.revoke(key.id)
    _, revoked = watched.tokens.with_hash(found_by)
    assert revoked.revoked_at is not None


def test_what_is_not_there_is_read_each_time(watched):
    assert watched.keys.with_hash(SECRET_HASH) is None
    with pytest.raises(NotKept), watched.kept_only():
        watched.keys.with_hash(SECRET_HASH)


def test_a_key_that_another_process_revokes_is_seen_within_a_second(watched, database_url):
    key = watched.keys.add(SECRET_HASH, ["localize"])
    assert watched.keys.with_hash(SECRET_HASH).revoked_at is None
    command = [sys.executable, "-c", REVOKE, database_url, key.id]
    subprocess.run(command, check=True, timeout=60)
    ended_s = time.monotonic()  # the commit was before
    asked_s = ended_s
    while watched.keys.with_hash(SECRET_HASH).revoked_at is None:  # however long a read takes
        assert asked_s - ended_s < 5 * SEEN_S  # tests run beside it
        time.sleep(0.02)
        asked_s = time.monotonic()


def test_what_is_kept_expires_a_second_after_postgresqls_channel_is_lost(postgresql):
    url = postgresql.new_database()
    name = url.partition("?")[0].rpartition("/")[2]
    catalog = Catalog(url)
    catalog.maps.create("campus")
    watch(catalog)
    postgresql.run(f"ALTER DATABASE {name} ALLOW_CONNECTIONS false", database="postgres")
    postgresql.run(
        "SELECT pg_terminate_backend(pid) FROM pg_stat_activity"
        f" WHERE datname = '{name}' AND query NOT LIKE '%pg_terminate%'",
        database="postgres",
    )
    time.sleep(SEEN_S)
    with pytest.raises(NotKept), catalog.kept_only():
        catalog.maps.get("campus")
    postgresql.run(f"ALTER DATABASE {name} ALLOW_CONNECTIONS true", database="postgres")
    other = Catalog(url)
    other.maps.update("campus", description="changed meanwhile")
    other.close()
    assert catalog.maps.get("campus").description == "changed meanwhile"
    catalog.close()


def test_keys_of_the_same_maps_get_the_same_summaries_until_a_map_changes(catalog):
    for slug in ("campus", "depot"):
        catalog.maps.create(slug)
    watch(catalog)
    limited = catalog.map_summaries.all(frozenset({"campus", "depot"}))
    assert [summary.slug for summary in limited] == ["campus", "depot"]
    assert catalog.map_summaries.all({"depot", "campus"}) is limited
    purge_map(catalog, "depot")
    changed = catalog.map_summaries.all({"depot", "campus"})
    assert [summary.slug for summary in changed] == ["campus"]


def test_a_key_gets_the_summaries_of_its_own_maps_only_whatever_others_asked_for(watched):
    watched.maps.create("depot")
    for slugs in (None, {"campus", "depot"}, {"campus"}, {"depot"}, set(), {"depot", "none"}):
        found = {summary.slug for summary in watched.map_summaries.all(slugs)}
        assert found == {"campus", "depot"} & ({"campus", "depot"} if slugs is None else slugs)
