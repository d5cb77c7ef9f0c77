"""What the catalog promises of keys, tokens, what they are limited to, and the audit log."""

import itertools
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from functools import partial
from threading import Barrier

import pytest
from sqlalchemy import update
from sqlalchemy.exc import IntegrityError

from core.errors import InvalidParameters
from storage.catalog import (
    Act,
    AuditCheck,
    AuditRecord,
    AuditState,
    on_behalf,
)
from storage.catalog.audit import START
from storage.catalog.pages import all_items
from storage.errors import (
    KeyNotFound,
    MapExists,
    TooManyTokens,
)


class TestKeys:
    def test_a_key_is_kept_by_its_hash_until_it_is_revoked(self, catalog):
        key = catalog.keys.add("hash", ["write", "read", "read"])
        assert (key.secret_hash, key.scopes) == ("hash", ["read", "write"])
        assert catalog.keys.get(key.id) == key
        assert catalog.keys.with_hash("hash") == key
        assert catalog.keys.with_hash("other") is None
        assert catalog.keys.list().items == (key,)
        revoked = catalog.keys.revoke(key.id)
        assert revoked.revoked_at >= key.created_at
        assert catalog.keys.revoke(key.id) == revoked
        assert catalog.keys.ever_made()
        with pytest.raises(KeyNotFound):
            catalog.keys.get("0" * 32)

    def test_a_key_keeps_its_limits_and_opens_until_it_ends(self, catalog):
        assert not catalog.keys.ever_made()
        now = datetime.now(UTC)
        key = catalog.keys.add(
            "hash",
            ["localize"],
            key_id="ab12",
            name="fleet",
            maps=["campus", "airport", "campus"],
            expires_at=now + timedelta(hours=1),
        )
        assert catalog.keys.get("ab12") == key
        assert (key.name, key.maps, key.first_run) == ("fleet", ["airport", "campus"], False)
        assert key.opens_at(now)
        assert not key.opens_at(now + timedelta(hours=1))
        assert not catalog.keys.revoke("ab12").opens_at(now)
        with pytest.raises(IntegrityError):
            catalog.keys.add("hash", ["localize"])

    def test_keys_are_listed_a_page_at_a_time_in_the_order_of_their_making(self, catalog):
        ids = [catalog.keys.add(f"hash {i}", ["localize"]).id for i in range(3)]
        page = catalog.keys.list(limit=2)
        assert [key.id for key in page.items] == ids[:2]
        rest = catalog.keys.list(page.next_after)
        assert ([key.id for key in rest.items], rest.next_after) == (ids[2:], None)
        with pytest.raises(InvalidParameters):
            catalog.keys.list("0" * 32)


def add_token(catalog, number, key_hash, expires_at, *, maps=None, most=100):
    return catalog.tokens.add(
        f"t{number}", f"hash {number}", key_hash, ["localize"], maps, expires_at, most=most
    )


class TestTokens:
    def test_a_token_is_found_with_its_key_until_one_is_added_after_its_end(self, catalog):
        now = datetime.now(UTC)
        key = catalog.keys.add("key hash", ["localize"])
        hour = now + timedelta(hours=1)
        token = add_token(catalog, "1", "key hash", hour, maps=["dock"])
        assert (token.scopes, token.maps, token.expires_at) == (["localize"], ["dock"], hour)
        assert catalog.tokens.with_hash("hash 1") == (token, key)
        revoked = catalog.keys.revoke(key.id)
        assert catalog.tokens.with_hash("hash 1") == (token, revoked)
        ended = add_token(catalog, "2", "of the settings", now)
        assert catalog.tokens.with_hash("hash 2") == (ended, None)
        add_token(catalog, "3", "key hash", hour)
        assert catalog.tokens.with_hash("hash 2") is None
        assert catalog.tokens.with_hash("hash 1") is not None
        assert catalog.tokens.with_hash("key hash") is None

    def test_a_key_has_as_many_valid_tokens_as_it_may(self, catalog):
        now = datetime.now(UTC)
        first_ends = now + timedelta(hours=1)
        add_token(catalog, "ended", "key hash", now, most=2)
        add_token(catalog, "1", "key hash", first_ends, most=2)
        add_token(catalog, "2", "key hash", first_ends + timedelta(minutes=1), most=2)
        with pytest.raises(TooManyTokens, match=f"limit of 2 valid tokens.*{first_ends:%H:%M:%S}"):
            add_token(catalog, "3", "key hash", first_ends, most=2)
        assert catalog.tokens.with_hash("hash 3") is None
        add_token(catalog, "4", "hash of another key", first_ends, most=1)
        add_token(catalog, "5", "key hash", first_ends, most=3)

    def test_no_key_has_more_tokens_by_requests_at_once(self, catalog):
        ends = datetime.now(UTC) + timedelta(hours=1)
        together = Barrier(16)

        def add(number):
            together.wait()
            add_token(catalog, number, "key hash", ends, most=2)

        with ThreadPoolExecutor(16) as pool:
            asked = [pool.submit(add, number) for number in range(16)]
        kinds = [type(one.exception()) for one in asked]
        assert (kinds.count(type(None)), kinds.count(TooManyTokens)) == (2, 14)


class TestLimitedLists:
    def test_maps_and_jobs_are_listed_of_the_named_maps_only(self, catalog):
        for slug in ("airport", "campus", "dock"):
            catalog.maps.create(slug)
        jobs = {slug: catalog.jobs.create(slug, {}).id for slug in ("campus", "dock")}
        some = ["dock", "airport", "nowhere"]
        first = catalog.maps.list(limit=1, slugs=some)
        assert [record.slug for record in first.items] == ["airport"]
        rest = catalog.maps.list(first.next_after, slugs=some)
        assert [record.slug for record in rest.items] == ["dock"]
        assert [job.id for job in catalog.jobs.list(slugs=some).items] == [jobs["dock"]]
        assert catalog.jobs.list("campus", slugs=some).items == ()
        assert catalog.maps.list(slugs=[]).items == ()


def changed_by(catalog, key_id, slug):
    """Make a map on behalf of a key."""
    with on_behalf(Act(key_id, "create_map", "/v1/maps", slug)):
        catalog.maps.create(slug)


def tamper(catalog, statement):
    with catalog._database.engine.begin() as connection:
        connection.exec_driver_sql(statement)


def january(day):
    return datetime(2026, 1, day, tzinfo=UTC)


def _page_after(page, cursor):
    return page(int(cursor or 0))


class TestAudit:
    def test_a_change_on_behalf_of_an_act_is_logged_with_it(self, catalog):
        before = datetime.now(UTC)
        catalog.maps.create("nobodys")
        changed_by(catalog, "ab12", "campus")
        [entry] = catalog.audit.list().items
        kept = (
            entry.seq,
            entry.key_id,
            entry.action,
            entry.subject,
            entry.map_slug,
            entry.outcome,
        )
        assert kept == (1, "ab12", "create_map", "/v1/maps", "campus", "done")
        assert before <= entry.at <= datetime.now(UTC)
        assert catalog.audit.verify().state == AuditState(1, entry.hash)

    def test_what_is_rolled_back_leaves_no_entry(self, catalog):
        changed_by(catalog, "ab12", "campus")
        with pytest.raises(MapExists):
            changed_by(catalog, "ab12", "campus")
        assert len(catalog.audit.list().items) == 1
        assert catalog.audit.verify().fault is None

    def test_one_act_is_one_entry_however_many_transactions_it_takes(self, catalog):
        with on_behalf(Act("ab12", "fill", "/v1")):
            catalog.maps.create("campus")
            catalog.maps.create("dock")
        assert len(catalog.audit.list().items) == 1

    def test_a_rejected_act_is_added_on_its_own(self, catalog):
        act = Act("ab12", "delete_map", "/v1/maps/campus", "campus")
        with on_behalf(act):
            catalog.audit.append(act, "403")
        assert [entry.outcome for entry in catalog.audit.list().items] == ["403"]

    def test_an_entry_is_what_was_written_whatever_characters_a_client_sent(self, catalog):
        texts = ["revision \0", "\0" * 301, "é\U0001f697\u2028", "a" * 299 + "\0b"]
        for text in texts:
            catalog.audit.append(Act("ab12", "make_live", f"/v1/{text}", "campus", text), "404")
        stored = [entry.detail for entry in catalog.audit.list().items]
        assert stored == [text[:300].replace("\0", "\ufffd") for text in texts]
        assert catalog.audit.verify().fault is None

    def test_entries_are_found_by_map_key_and_time_a_page_at_a_time(self, catalog):
        for key, slug in (("a", "one"), ("b", "two"), ("a", "three"), ("a", "four")):
            changed_by(catalog, key, slug)
        every = catalog.audit.list().items
        assert [entry.seq for entry in every] == [1, 2, 3, 4]
        first = catalog.audit.list(limit=2, key_id="a")
        assert [entry.map_slug for entry in first.items] == ["one", "three"]
        rest = catalog.audit.list(int(first.next_after), 2, key_id="a")
        assert ([entry.map_slug for entry in rest.items], rest.next_after) == (["four"], None)
        assert [entry.seq for entry in catalog.audit.list(map_slug="two").items] == [2]
        assert catalog.audit.list(map_slug="nowhere").items == ()
        assert catalog.audit.list(since=every[2].at).items[-2:] == every[2:]
        assert every[2] not in catalog.audit.list(until=every[2].at).items

    def test_entries_are_found_by_their_actions_in_either_order(self, catalog):
        for number, action in enumerate(["make", "use", "make", "lose", "make"]):
            catalog.audit.append(Act("ab"[number % 2], action, f"/v1/{number}"), "done")

        def places(**chosen):
            return [entry.seq for entry in catalog.audit.list(**chosen).items]

        assert places(newest_first=True) == [5, 4, 3, 2, 1]
        assert places(actions=["make"]) == [1, 3, 5]
        assert places(actions=["lose", "use", "use"], newest_first=True) == [4, 2]
        assert places(actions=["make", "use"], key_id="a", newest_first=True) == [5, 3, 1]
        assert places(actions=["make", "use", "lose"], limit=2) == [1, 2]
        assert places(actions=["other"]) == []

    def test_pages_newest_first_have_each_entry_once_while_others_are_added(self, catalog):
        for number in range(7):
            catalog.audit.append(Act("a", "make", f"/v1/{number}"), "done")
        found, after = [], 0
        while True:
            page = catalog.audit.list(after, 2, actions=["make", "use"], newest_first=True)
            found += [entry.seq for entry in page.items]
            catalog.audit.append(Act("a", "make", "/v1/meanwhile"), "done")
            if page.next_after is None:
                break
            after = int(page.next_after)
        assert found == [7, 6, 5, 4, 3, 2, 1]

    @pytest.mark.parametrize("few", [10_000, 1])
    def test_times_end_both_orders_whatever_the_clock_said(self, catalog, monkeypatch, few):
        monkeypatch.setattr("storage.catalog.audit._FEW", few)
        days = {1: 1, 2: 5, 3: 2, 4: 3, 5: 6}  # by place
        for place, day in days.items():
            catalog.audit.append(Act("a", "make", f"/v1/{place}"), "done")
            with catalog._database.engine.begin() as connection:
                moved = update(AuditRecord).where(AuditRecord.seq == place)
                connection.execute(moved.values(at=january(day)))
        for since, until in itertools.product(range(1, 8), repeat=2):
            expected = [place for place, day in days.items() if since <= day < until]
            limits = {"since": january(since), "until": january(until), "limit": 2}
            for newest_first in (False, True):
                page = partial(catalog.audit.list, newest_first=newest_first, **limits)
                found = [entry.seq for entry in all_items(partial(_page_after, page))]
                assert found == expected[:: -1 if newest_first else 1]

    def test_a_whole_log_is_good_and_its_states_are_known_again(self, catalog):
        states = [catalog.audit.verify().state]
        assert catalog.audit.verify(states[0]) == AuditCheck(START, None)
        for slug in ("one", "two", "three"):
            changed_by(catalog, "ab12", slug)
            states.append(catalog.audit.verify().state)
        for known in states:
            assert catalog.audit.verify(known) == AuditCheck(states[-1], None)

    @pytest.mark.parametrize(
        ("statement", "good", "fault"),
        [
            ("UPDATE audit SET key_id = 'other' WHERE seq = 3", 2, "3 is not what was written"),
            ("UPDATE audit SET action = 'other' WHERE seq = 4", 3, "4 is not what was written"),
            ("UPDATE audit SET subject = 'other' WHERE seq = 2", 1, "2 is not what was written"),
            ("UPDATE audit SET detail = 'other' WHERE seq = 5", 4, "5 is not what was written"),
            ("UPDATE audit SET outcome = '403' WHERE seq = 1", 0, "1 is not what was written"),
            ("UPDATE audit SET map_slug = NULL WHERE seq = 5", 4, "5 is not what was written"),
            ("UPDATE audit SET at = '2020-01-01 00:00:00' WHERE seq = 2", 1, "2 is not what was"),
            ("DELETE FROM audit WHERE seq = 3", 2, "3 is gone"),
            ("DELETE FROM audit WHERE seq = 1", 0, "1 is gone"),
            ("DELETE FROM audit WHERE seq = 5", 4, "had 5 entries, 4 are left"),
            ("UPDATE audit SET seq = 9 WHERE seq = 2", 1, "2 is gone; 3 follows"),
            ("DELETE FROM audit", 0, "had 5 entries, 0 are left"),
            ("UPDATE audit SET seq = 9 WHERE seq = 5", 4, "had 5 entries, 4 are left"),
            (
                "INSERT INTO audit (seq, at, key_id, action, subject, map_slug, detail, outcome,"
                " hash) SELECT 6, at, key_id, action, subject, map_slug, detail, outcome, hash"
                " FROM audit WHERE seq = 5",
                5,
                "entry 6 follows the last one that was written",
            ),
            ("DELETE FROM audit_head", 0, "the head of the log is gone"),
        ],
    )
    def test_a_changed_or_removed_entry_is_found(self, catalog, statement, good, fault):
        for number in range(5):
            changed_by(catalog, "ab12", f"map-{number}")
        tamper(catalog, statement)
        found = catalog.audit.verify()
        assert found.state.seq == good
        assert fault in found.fault

    def test_a_rewritten_log_is_detected_by_a_state_stored_elsewhere(self, catalog):
        for slug in ("one", "two", "three"):
            changed_by(catalog, "ab12", slug)
        known = catalog.audit.verify().state
        tamper(catalog, "DELETE FROM audit")
        tamper(catalog, f"UPDATE audit_head SET seq = 0, hash = '{START.hash}'")
        for slug in ("new-one", "new-two"):
            changed_by(catalog, "ab12", slug)
        assert catalog.audit.verify().fault is None
        assert "was known, 2 are left" in catalog.audit.verify(known).fault
        changed_by(catalog, "ab12", "new-three")
        assert "3 is not the one that was known" in catalog.audit.verify(known).fault

    def test_changes_at_once_make_one_chain(self, catalog):
        with ThreadPoolExecutor(8) as pool:
            slugs = [f"map-{number}" for number in range(24)]
            list(pool.map(lambda slug: changed_by(catalog, "ab12", slug), slugs))
        assert catalog.audit.verify() == AuditCheck(catalog.audit.verify().state, None)
        assert {entry.map_slug for entry in catalog.audit.list().items} == set(slugs)

    def test_a_state_is_a_number_and_a_hash(self):
        for seq, digest in ((-1, "0" * 64), (3, "0" * 63)):
            with pytest.raises(InvalidParameters):
                AuditState(seq, digest)
