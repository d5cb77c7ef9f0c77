"""Notes of a build on the scans of its drives."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.builds.drive_notes import _twice_notes
from app.builds.parameters import BuildParameters
from app.builds.plans import plan_build
from app.builds.revision_build import build_revision
from core.scans.scan import Scan
from storage.store import Store
from tests.support.new_catalog import put_new_catalog
from tests.support.recording import recording

SCANS = recording().scans


@pytest.fixture
def built(tmp_path):
    """Return the notes of a build of numbered scans, and of another drive."""
    put_new_catalog(tmp_path / "catalog.sqlite3")

    def build(numbered, accumulate=1, tuesday=()):
        with Store.serving(tmp_path) as store:
            store.maps.create("campus")
            store.drives.put("campus", "monday", None, accumulate)
            store.drives.put_scans("campus", "monday", list(numbered))
            if tuesday:
                store.drives.put_scans("campus", "tuesday", list(enumerate(tuesday)))
            job = store.jobs.create("campus", {})
            store.jobs.claim()
            plan = plan_build(
                store, job.map_id, BuildParameters(segments=1, odometry=False, encoding="paper")
            )
            build_revision(store, job.map_id, plan, job_id=job.id)
            return store.jobs.get(job.id).notes

    return build


@pytest.fixture
def notes_on(built):
    """Return the notes of a build of scans that concern frozen ones."""

    def build(scans):
        return [note for note in built(enumerate(scans)) if "are equal" in note]

    return build


NOWHERE = Scan(np.full((200, 3), 5000.0, np.float32), pose=SCANS[5].pose)
"""Outside of every grid."""


def test_a_scan_that_is_left_out_is_named_by_its_number(built):
    scans = [*SCANS[:5], NOWHERE, *SCANS[6:12]]
    [note] = [note for note in built(zip(range(100, 124, 2), scans, strict=True)) if "left" in note]
    assert note.startswith("1 of 12 scans of drive monday is left out, first scan 110: ")


def test_scans_of_several_that_are_left_out_are_counted_as_such(built):
    scans = [*SCANS[:4], *[NOWHERE] * 4, *SCANS[8:16]]
    [note] = [note for note in built(enumerate(scans), accumulate=4) if "left out" in note]
    assert note.startswith(
        "1 of 4 scans of drive monday, each of 4 that become one, is left out, first scan 7: "
    )


def test_scans_that_differ_are_not_noted(notes_on):
    assert notes_on(SCANS[:12]) == []


def test_a_vehicle_that_stands_is_not_noted(notes_on):
    rng = np.random.default_rng(1)
    shape = SCANS[0].points_m.shape
    noise = rng.normal(0.0, 0.01, (12, *shape)).astype(np.float32)
    assert notes_on([Scan(SCANS[0].points_m + of, pose=SCANS[0].pose) for of in noise]) == []


def test_a_scan_that_was_stored_twice_is_not_noted(notes_on):
    assert notes_on([*SCANS[:9], SCANS[8], *SCANS[9:12]]) == []


def test_scans_that_repeat_are_noted_with_where(notes_on):
    scans = [*SCANS[:4], *[SCANS[4]] * 6, *SCANS[5:20]]
    [note] = notes_on(scans)
    assert note == (
        "5 of 25 scans of drive monday are equal to the scan before them, most in a row are scans 4"
        " to 9: did the sensor or its driver stop, and send its last scan again?"
    )


def test_a_drive_of_one_scan_over_and_over_holds_one_place(notes_on):
    [note] = notes_on([SCANS[0]] * 12)
    assert note.startswith("11 of 12 scans of drive monday are equal to the scan before them")
    assert note.endswith("send its last scan again? they show one place")


def test_a_recording_that_is_there_twice_is_noted(built):
    [note] = [note for note in built(enumerate(SCANS[:12]), tuesday=SCANS[4:14]) if "twice" in note]
    assert note == (
        "8 of 10 scans of drive tuesday are those of drive monday: is one recording there"
        " twice? Leave one out"
    )


def test_drives_that_share_a_scan_or_two_where_a_recording_was_cut_are_not_noted(built):
    assert not [n for n in built(enumerate(SCANS[:9]), tuesday=SCANS[7:16]) if "twice" in n]


def drive_of(at, digests) -> Any:
    return SimpleNamespace(name=f"d{at}", digests=digests)


def compared_in_pairs(drives):
    """Return for each drive the first earlier one that has enough of its scans, and how many."""
    for at, drive in enumerate(drives):
        digests = set(drive.digests)
        for earlier in drives[:at]:
            shared = len(digests.intersection(earlier.digests))
            if shared >= max(3, 0.2 * len(digests)):
                yield f"{shared} of {len(digests)} scans of drive {drive.name} are", earlier.name
                break


@given(st.lists(st.lists(st.integers(0, 40), min_size=1, max_size=30), max_size=12))
def test_of_the_earlier_drives_that_share_scans_the_first_is_noted(scans):
    drives = [drive_of(at, of) for at, of in enumerate(scans)]
    wanted = list(compared_in_pairs(drives))
    notes = list(_twice_notes(drives))
    assert len(notes) == len(wanted)
    for note, (begin, earlier) in zip(notes, wanted, strict=True):
        assert note.startswith(f"{begin} those of drive {earlier}: ")
