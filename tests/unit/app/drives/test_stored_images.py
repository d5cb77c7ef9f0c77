"""The images that builds keep of a drive that grows meanwhile."""

from dataclasses import replace

import numpy as np
import pytest

from app.drives import stored_images
from app.drives.stored_images import images_path, open_images, require_images
from core.parameters import MapParameters
from core.scans.mounting import Mounting
from core.scans.pose import Pose
from storage.errors import ReturnsGone
from storage.files.image_file import remove_other_versions
from storage.store import Store
from tests.support.new_catalog import put_new_catalog
from tests.support.small_scans import sample_scan

PARAMETERS = MapParameters()


@pytest.fixture
def store(tmp_path):
    put_new_catalog(tmp_path / "catalog.sqlite3")
    with Store(tmp_path) as opened:
        opened.maps.create("campus")
        yield opened


def grown(store, scans):
    """Return the drive once it has so many scans."""
    store.drives.put_scans("campus", "monday", [(at, sample_scan(at)) for at in range(scans)])
    return store.drives.open("campus", "monday")


def kept(store):
    return set(store.layout.maps.rglob("images/*.h5"))


def project(store, drive):
    open_images(store, drive, PARAMETERS).close()
    return images_path(store, drive, PARAMETERS)


def test_a_build_that_began_earlier_and_ends_later_leaves_the_images_of_more_scans(store):
    fewer, more = grown(store, 2), grown(store, 3)
    of_more = project(store, more)
    of_fewer = project(store, fewer)
    assert kept(store) == {of_fewer, of_more}


def test_the_images_of_a_drive_as_it_was_are_removed(store):
    project(store, grown(store, 2))
    fewer = grown(store, 3)
    project(store, grown(store, 4))
    grown(store, 5)
    of_fewer = project(store, fewer)
    assert kept(store) == {of_fewer}
    of_all = project(store, grown(store, 5))
    assert kept(store) == {of_all}


def test_images_that_another_build_removes_once_they_are_made_can_be_read(store, monkeypatch):
    fewer = grown(store, 2)

    def remove_after_another_build(*paths):
        monkeypatch.undo()
        project(store, grown(store, 3))
        remove_other_versions(*paths)

    monkeypatch.setattr(stored_images, "remove_other_versions", remove_after_another_build)
    with open_images(store, fewer, PARAMETERS) as images:
        assert len(images.read(0, 2)) == 2


def driven(store, *, metres_a_scan):
    """Return a drive of five scans with poses along a line."""
    poses = {at: Pose(at * metres_a_scan, 0, 0, 0, 0, 0, 1) for at in range(5)}
    grown(store, 5)
    store.drives.put_poses("campus", "monday", poses)
    return store.drives.open("campus", "monday")


def test_probes_are_those_of_the_poses_that_the_drive_has(store):
    before = project(store, grown(store, 5)).read_bytes()
    first = project(store, driven(store, metres_a_scan=2.0)).read_bytes()
    assert first != before
    path = project(store, driven(store, metres_a_scan=3.0))
    other = path.read_bytes()
    assert other != first
    path.unlink()
    assert project(store, driven(store, metres_a_scan=3.0)).read_bytes() == other


def test_probes_of_the_same_poses_are_made_once(store):
    path = project(store, driven(store, metres_a_scan=2.0))
    made = path.stat()
    assert project(store, driven(store, metres_a_scan=2.0)) == path
    assert path.stat() == made


def test_probes_of_other_poses_are_kept_once_the_returns_are_gone(store):
    project(store, driven(store, metres_a_scan=2.0))
    drive = driven(store, metres_a_scan=3.0)
    drive.has_returns = np.zeros(5, np.bool_)
    with open_images(store, drive, PARAMETERS) as images:
        assert images.probes is not None
        assert len(images.probed) == len(images.probes) == 5


def dropped(store, monkeypatch):
    """Let the catalog count two scans of each drive as dropped."""
    counted = store.drives.counted
    monkeypatch.setattr(
        store.drives,
        "counted",
        lambda drives: [replace(drive, scans_without_returns=2) for drive in counted(drives)],
    )


@pytest.mark.parametrize("mounting", [None, Mounting(1.0, 0.5, 2.0, yaw_deg=90.0)])
@pytest.mark.parametrize("accumulate", [1, 2])
def test_images_are_required_where_builds_keep_them(store, monkeypatch, mounting, accumulate):
    driven(store, metres_a_scan=2.0)
    store.drives.put("campus", "monday", mounting=mounting, accumulate=accumulate)
    dropped(store, monkeypatch)
    map_id = store.maps.get("campus").id
    with pytest.raises(ReturnsGone, match=r"'monday': .* the returns of 2 of 5 scans were dropped"):
        require_images(store, map_id, ["monday"], PARAMETERS)
    images_path(store, store.drives.open("campus", "monday"), PARAMETERS).touch()
    require_images(store, map_id, ["monday"], PARAMETERS)


def test_images_are_required_without_the_facts_of_all_scans(store, monkeypatch):
    project(store, driven(store, metres_a_scan=2.0))
    dropped(store, monkeypatch)
    monkeypatch.setattr(store.drives, "open_of_map", None)
    require_images(store, store.maps.get("campus").id, ["monday"], PARAMETERS)
