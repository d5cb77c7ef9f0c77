"""A build that is claimed."""

import pytest

from storage.store import Store
from tests.support.recording import recording


@pytest.fixture
def claimed(tmp_path):
    """A store with one scan and a build that is claimed, as a worker finds it."""
    with Store(tmp_path) as store:
        store.maps.create("campus")
        store.drives.put_scan("campus", "monday", 0, recording().scans[0])
        store.jobs.create("campus", {})
        job = store.jobs.claim()
        assert job is not None
        yield store, job
