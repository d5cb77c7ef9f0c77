"""Notes of a build on the anchor of its map."""

from dataclasses import replace

import pytest

from app.builds.anchor_notes import frame_notes
from app.builds.parameters import BuildParameters
from app.builds.plans import plan_build
from app.builds.revision_build import build_revision
from core.mapping.anchor import Anchor
from core.mapping.merge import without_drives
from core.mapping.placement import Placement
from core.scans.pose import Pose
from storage.store import Store
from tests.support.new_catalog import put_new_catalog
from tests.support.recording import recording
from tests.support.samples import sample_map

SCANS = 8


@pytest.fixture
def store(store):
    store.drives.put_scans("campus", "monday", list(enumerate(recording().scans[:SCANS])))
    build(store)
    return store


def build(store, segments=1, **parameters):
    """Return the notes on the anchor of a build of a map, whose first one becomes live."""
    job = store.jobs.create("campus", {})
    store.jobs.claim()
    plan = plan_build(
        store, job.map_id, BuildParameters(segments=segments, encoding="paper", **parameters)
    )
    build_revision(store, job.map_id, plan, job_id=job.id)
    return [note for note in store.jobs.get(job.id).notes if "anchor" in note]


def move(store, x_m):
    poses = [recording().pose(at).as_tuple() for at in range(SCANS)]
    moved = {at: Pose(pose[0] + x_m, *pose[1:]) for at, pose in enumerate(poses)}
    store.drives.put_poses("campus", "monday", moved)


def anchor(store):
    store.maps.update("campus", anchor=Anchor(49.01, 8.4))


def test_a_build_in_another_frame_than_that_of_the_anchor_is_noted(store):
    anchor(store)
    move(store, 450.0)
    [note] = build(store)
    live = store.maps.get("campus").live_revision
    assert note == (
        f"drive monday is 450.0 m (median) from where it is in live revision {live[:12]}: the"
        " map's anchor is of that one's frame, set it again if this revision becomes live"
    )


def test_a_map_without_an_anchor_may_change_its_frame(store):
    move(store, 450.0)
    assert build(store) == []


@pytest.mark.parametrize("x_m", [0.0, 3.0])
def test_poses_that_were_corrected_a_little_keep_the_anchor(store, x_m):
    anchor(store)
    move(store, x_m)
    assert build(store, segments=2) == []


def test_a_build_of_new_drives_only_is_noted_as_its_frame_may_be_another(store):
    anchor(store)
    store.drives.put_scans("campus", "tuesday", list(enumerate(recording().scans[:SCANS])))
    [note] = build(store, drives=["tuesday"])
    live = store.maps.get("campus").live_revision
    assert note == (
        f"no drive of live revision {live[:12]} has a place in this revision: the map's anchor is"
        " of that one's frame, check it if this revision becomes live"
    )
    assert build(store, drives=["monday", "tuesday"]) == []


def test_a_live_revision_without_places_has_no_frame_to_leave(tmp_path):
    put_new_catalog(tmp_path / "catalog.sqlite3")
    with Store.serving(tmp_path) as opened:
        opened.maps.create("campus")
        for drive in ("monday", "tuesday"):
            scans = [replace(scan, pose=None) for scan in recording().scans[:SCANS]]
            opened.drives.put_scans("campus", drive, list(enumerate(scans)))
        build(opened, drives=["monday"], odometry=False)
        anchor(opened)
        assert build(opened, drives=["tuesday"], odometry=False) == []


def test_that_the_frame_becomes_that_of_a_drive_which_lay_beside_it_is_noted():
    """It has places on the Earth then, but the anchor is of the drives that are gone."""
    tensor_map, _ = sample_map(drives=3)
    lies = Placement((0.0, 0.0, 0.0, 1.0), (1000.0, 0.0, 0.0))
    meets = replace(lies, others=("drive-1",), matches=20)
    whole = replace(tensor_map, placements={"drive-1": lies, "drive-2": meets})
    rest = without_drives(whole, ["drive-0"])
    assert [*frame_notes(whole, rest, is_live=True)] == [
        f"drive drive-1 is not in the frame of both this revision and revision"
        f" {whole.revision[:12]}, which was live: the map's anchor is of that one's frame, set it"
        " again"
    ]
    [note] = frame_notes(rest, whole, is_live=False)
    assert note.startswith("drive drive-1 is not in the frame of both this revision and live")
    assert [*frame_notes(whole, without_drives(whole, ["drive-1"]), is_live=True)] == []
