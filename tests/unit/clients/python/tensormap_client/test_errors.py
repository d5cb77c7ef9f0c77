import copy
import pickle

import pytest
from tensormap_client import NothingUsable, Rejected
from tensormap_client.problems import MapNotFound, NothingStored
from tensormap_client.uploaded import SkippedScan


@pytest.mark.parametrize("copied", [copy.copy, lambda error: pickle.loads(pickle.dumps(error))])
@pytest.mark.parametrize("kind", [MapNotFound, NothingStored, Rejected])
def test_a_rejection_reaches_the_process_that_started_the_work(kind, copied) -> None:
    error = kind("GET /: 429 new: later", 429, "new", "later", 7.0)
    error.set_aside = [{"file": "a.bin"}]
    error.add_note("of drive monday")
    found = copied(error)
    assert (type(found), str(found)) == (kind, "GET /: 429 new: later")
    assert vars(found) == vars(error)


def test_the_skipped_scans_of_an_upload_reach_it_too() -> None:
    error = NothingUsable("none can be used", [SkippedScan(0, "it is empty")])
    assert pickle.loads(pickle.dumps(error)).skipped == error.skipped
