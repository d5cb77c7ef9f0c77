"""The store against a model: a dict from drive to a dict from index to content."""

import tempfile
from pathlib import Path

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from storage.errors import DriveClosed, DriveExists, DriveNotFound, ScanConflict
from storage.store import Store
from tests.support.catalog_rows import stored_scans
from tests.support.small_scans import sample_scan

pytestmark = pytest.mark.slow

slugs = st.sampled_from(["monday", "tuesday"])
indices = st.integers(0, 5)
seeds = st.integers(0, 1)  # few, so that the same content often comes again


class StoreMachine(RuleBasedStateMachine):
    def __init__(self):
        super().__init__()
        self.folder = tempfile.TemporaryDirectory()
        self.store = Store(Path(self.folder.name))
        self.store.maps.create("campus")
        self.drives: dict[str, dict[int, int]] = {}
        self.closed: set[str] = set()
        self.deleted: dict[str, tuple[dict[int, int], bool]] = {}  # by entry of the recycle bin

    def teardown(self):
        self.store.close()
        self.folder.cleanup()

    @rule(slug=slugs, scans=st.dictionaries(indices, seeds, min_size=1, max_size=3))
    def put(self, slug, scans):
        stored = self.drives.get(slug, {})
        sent = [(index, sample_scan(seed)) for index, seed in scans.items()]
        if any(stored.get(index, seed) != seed for index, seed in scans.items()):
            with pytest.raises(ScanConflict):
                self.store.drives.put_scans("campus", slug, sent)
        elif slug in self.closed and scans.keys() - stored.keys():
            with pytest.raises(DriveClosed):
                self.store.drives.put_scans("campus", slug, sent)
        else:
            results = self.store.drives.put_scans("campus", slug, sent)
            assert [r.created for r in results] == [index not in stored for index in scans]
            self.drives[slug] = stored | scans

    @rule(slug=slugs)
    def close(self, slug):
        if slug in self.drives:
            self.store.drives.close("campus", slug)
            self.closed.add(slug)
        else:
            with pytest.raises(DriveNotFound):
                self.store.drives.close("campus", slug)

    @rule(slug=slugs)
    def delete(self, slug):
        held = self.drives.pop(slug, None)
        if held is None:
            with pytest.raises(DriveNotFound):
                self.store.drives.delete("campus", slug)
        else:
            entry = self.store.drives.delete("campus", slug)
            self.deleted[entry.id] = (held, slug in self.closed)
            self.closed.discard(slug)

    @rule(slug=slugs, first=st.booleans())
    def restore(self, slug, first):
        if self.deleted:
            entry = list(self.deleted)[0 if first else -1]
            if slug in self.drives:
                with pytest.raises(DriveExists):
                    self.store.recycle_bin.restore(entry, slug)
            else:
                self.store.recycle_bin.restore(entry, slug)
                self.drives[slug], was_closed = self.deleted.pop(entry)
                self.closed |= {slug} if was_closed else set()

    @rule()
    def purge(self):
        if self.deleted:
            entry, _ = self.deleted.popitem()
            self.store.recycle_bin.purge(entry)

    @rule()
    def restart(self):
        self.store.close()
        self.store = Store(Path(self.folder.name))
        self.store.recover()

    @invariant()
    def the_store_holds_what_the_model_holds(self):
        listed = self.store.drives.list("campus").items
        assert {drive.slug: drive.closed for drive in listed} == {
            slug: slug in self.closed for slug in self.drives
        }
        for slug, scans in self.drives.items():
            drive = self.store.drives.open("campus", slug)
            assert drive.scan_index.tolist() == sorted(scans)
            for position, index in enumerate(sorted(scans)):
                expected = sample_scan(scans[index]).points_m
                assert drive.scan(position).points_m.tobytes() == expected.tobytes()
        kept = {path.name for path in self.store.layout.maps.rglob("*.h5")}
        named = {r.chunk for s in self.drives for r in stored_scans(self.store, "campus", s)}
        in_bin = self.store.recycle_bin.list().items
        assert {entry.id for entry in in_bin} == set(self.deleted)
        for entry in in_bin:
            records = self.store.catalog.scans.of_drive(entry.id)
            assert [record.index for record in records] == sorted(self.deleted[entry.id][0])
            named |= {record.chunk for record in records}
        assert kept == named


StoreMachine.TestCase.settings = settings(max_examples=10, stateful_step_count=12, deadline=None)
TestStore = StoreMachine.TestCase
