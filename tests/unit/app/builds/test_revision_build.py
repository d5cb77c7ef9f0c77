"""Builds from the store: of the requested map, and never from damaged images."""

import h5py
import pytest

from app.builds import revision_build
from app.builds.live_gate import compare_with_live, pass_gate
from app.builds.parameters import BuildParameters
from app.builds.plans import plan_build
from app.builds.recall import DrivenMap
from app.builds.revision_build import build_revision as build_planned
from core.progress import Progress
from storage.catalog import JobState
from storage.errors import CorruptFile, DriveNotFound, JobNotRunning, MapNotFound
from storage.files.image_file import write_image_file
from tests.support.map_files import revision_file
from tests.support.recording import recording
from tests.support.samples import sample_harmonic_map

SCANS = 8
PARAMETERS = BuildParameters(segments=2)


@pytest.fixture
def store(store):
    put(store)
    return store


def put(store):
    store.drives.put_scans("campus", "monday", list(enumerate(recording().scans[:SCANS])))


def build_revision(store, map_id, parameters, *progress, **job):
    return build_planned(store, map_id, plan_build(store, map_id, parameters), *progress, **job)


class AtTheEnd:
    """Does something once the last unit of a stage is done."""

    def __init__(self, stage, act):
        self._stage, self._act = stage, act
        self._left = -1

    def start(self, stage, total):
        self._left = total if stage == self._stage else -1

    def advance(self, units=1):
        self._left -= units
        if self._left == 0:
            self._act()


def stages_of(store):
    seen: list[str] = []

    class Seen:
        def start(self, stage, total):
            seen.append(stage)

        def advance(self, units=1):
            pass

    progress: Progress = Seen()
    record = build_revision(store, store.maps.get("campus").id, PARAMETERS, progress)
    return seen, record


def files_of(store):
    return sorted(
        path.relative_to(store.layout.maps)
        for path in store.layout.maps.rglob("*")
        if path.is_file()
    )


@pytest.mark.parametrize(("stage", "how"), [("projecting", "purge"), ("fitting", "delete")])
def test_a_map_that_is_made_anew_during_a_build_gets_nothing_of_the_old_one(store, stage, how):
    def make_anew():
        getattr(store.maps, how)("campus")
        store.maps.create("campus")
        put(store)

    map_id = store.maps.get("campus").id
    with pytest.raises(MapNotFound):
        build_revision(store, map_id, PARAMETERS, AtTheEnd(stage, make_anew))
    made = store.maps.get("campus")
    assert made.id != map_id
    assert made.live_revision is None
    assert store.revisions.list("campus").items == ()
    in_bin = {entry.map_id for entry in store.recycle_bin.list().items}
    assert {path.parts[0] for path in files_of(store)} == {made.id} | in_bin
    assert not any("revisions" in path.parts for path in files_of(store))
    assert not any("revisions" in path.parts for path in files_of(store))


@pytest.mark.parametrize("stage", ["projecting", "calibrating", "calibrating scans"])
@pytest.mark.parametrize("again", [False, True])
def test_a_build_whose_drive_is_deleted_before_its_end_fails(store, stage, again):
    def delete():
        store.drives.delete("campus", "monday")
        if again:
            put(store)

    with pytest.raises(DriveNotFound, match="'monday'"):
        build_revision(store, store.maps.get("campus").id, PARAMETERS, AtTheEnd(stage, delete))
    assert store.revisions.list("campus").items == ()


def test_a_map_that_is_renamed_during_a_build_gets_its_revision(store):
    def rename():
        store.recycle_bin.restore(store.maps.delete("campus").id, "yard")
        store.maps.create("campus")

    map_id = store.maps.get("campus").id
    record = build_revision(store, map_id, PARAMETERS, AtTheEnd("fitting", rename))
    assert record.map_id == map_id
    assert store.maps.get("yard").live_revision == record.digest
    assert store.maps.get("campus").live_revision is None
    assert revision_file(store, "yard", record.digest).is_relative_to(store.layout.map(map_id))


def test_a_build_is_compared_again_with_a_revision_that_became_live_meanwhile(store, monkeypatch):
    map_id = store.maps.get("campus").id
    first, second = (
        build_revision(store, map_id, BuildParameters(segments=segments)) for segments in (2, 3)
    )
    compared = []

    def decide(*arguments):
        gate = pass_gate(*arguments)
        compared.append(gate.compared_with)
        store.revisions.set_live("campus", second.digest)
        return gate

    monkeypatch.setattr(revision_build, "pass_gate", decide)
    expected = BuildParameters(segments=4, make_live=True, max_recall_loss=1.0)
    third = build_revision(store, map_id, expected)
    assert compared == [first.digest, second.digest]
    assert store.revisions.live("campus") == third
    assert len(list(store.layout.revisions(map_id).iterdir())) == 3  # none of the lost race


def test_a_first_build_is_compared_with_one_that_became_live_meanwhile(store, monkeypatch):
    map_id = store.maps.get("campus").id
    compared = []

    def decide(*arguments):
        gate = pass_gate(*arguments)
        compared.append(gate.compared_with)
        if len(compared) == 1:
            build_revision(store, map_id, PARAMETERS)
        return gate

    monkeypatch.setattr(revision_build, "pass_gate", decide)
    expected = BuildParameters(segments=4, make_live=True, max_recall_loss=1.0)
    second = build_revision(store, map_id, expected)
    [_, first] = store.revisions.list("campus").items
    assert compared == [None, first.digest]
    assert store.revisions.live("campus") == second


def test_recall_on_new_drives_that_are_not_stored_here_cannot_be_measured(store):
    map_id = store.maps.get("campus").id
    live = build_revision(store, map_id, PARAMETERS)
    store.drives.put_scans(
        "campus", "tuesday", list(enumerate(recording().scans[SCANS : 2 * SCANS]))
    )
    both = build_revision(store, map_id, PARAMETERS)
    imported = DrivenMap(live.drive_ids, store.revisions.read(both))  # as of a file
    gate = compare_with_live(store, map_id, imported, 1.0)
    assert not gate.live
    assert "on its new drives cannot be measured: not-built-here" in str(gate.reason)


def test_a_live_revision_that_cannot_be_read_does_not_hold_up_its_successor(store):
    map_id = store.maps.get("campus").id
    first = build_revision(store, map_id, PARAMETERS)
    store.revisions.path_of(first).unlink()
    built = DrivenMap(first.drive_ids, sample_harmonic_map()[0])
    gate = pass_gate(store, map_id, built, BuildParameters(make_live=True))
    assert gate.live
    assert "cannot be read" in str(gate.reason)


def test_images_that_were_damaged_are_made_anew_and_the_revision_is_the_same(store):
    _, whole = stages_of(store)
    kept = ["fitting", "calibrating", "calibrating scans"]  # from the images that are kept
    assert stages_of(store)[0] == kept
    damage(store)
    seen, again = stages_of(store)
    assert seen == ["fitting", "projecting", "fitting", "calibrating", "calibrating scans"]
    assert again.digest == whole.digest
    assert stages_of(store)[0] == ["fitting", "calibrating", "calibrating scans"]


def test_images_that_are_damaged_each_time_end_the_build(store, monkeypatch):
    def write_and_damage(path, *args):
        write_image_file(path, *args)
        damage(store)

    monkeypatch.setattr("app.drives.stored_images.write_image_file", write_and_damage)
    with pytest.raises(CorruptFile):
        stages_of(store)
    assert store.revisions.list("campus").items == ()


def test_damaged_probes_of_the_live_revision_leave_a_build_done_and_not_live(store):
    map_id = store.maps.get("campus").id
    live = build_revision(store, map_id, PARAMETERS)
    damage(store, "probes")
    other = BuildParameters(segments=2, encoding="paper", make_live=True)
    built = build_revision(store, map_id, other)
    assert store.maps.get("campus").live_revision == live.digest != built.digest
    gate = pass_gate(store, map_id, DrivenMap(built.drive_ids, store.revisions.read(built)), other)
    why = f"recall of live revision {live.digest[:12]} cannot be measured: images-not-kept"
    assert why in str(gate.reason)


def damage(store, name="images"):
    [path] = store.layout.maps.rglob("images/*.h5")
    with h5py.File(path, "r") as file:
        at = file[name].id.get_chunk_info(0).byte_offset
    content = bytearray(path.read_bytes())
    content[at + 1000] ^= 1
    path.write_bytes(content)


def test_a_job_is_done_at_the_moment_its_revision_is_published(store):
    """A worker killed or cancelled after it published leaves a job that is done."""
    job = store.jobs.create("campus", {})
    store.jobs.claim()
    store.jobs.request_cancel(job.id)
    record = build_revision(store, job.map_id, PARAMETERS, job_id=job.id)
    with pytest.raises(JobNotRunning):  # what the runner does with a worker that died
        store.jobs.cancelled(job.id)
    store.recover()  # or the next start
    ended = store.jobs.get(job.id)
    assert (ended.state, ended.revision) == (JobState.DONE, record.digest)
    assert store.jobs.finish(job.id, record.digest) == ended  # what a worker that lives does


def test_images_without_probes_are_made_anew_and_without_returns_the_map_is_not_calibrated(
    store, monkeypatch
):
    seen, _ = stages_of(store)
    assert seen == ["checking poses", "projecting", "fitting", "calibrating", "calibrating scans"]
    seen, _ = stages_of(store)
    assert seen == ["fitting", "calibrating", "calibrating scans"]
    drop_probes(store)
    seen, _ = stages_of(store)
    assert seen == ["projecting", "fitting", "calibrating", "calibrating scans"]
    drop_probes(store)

    def gone(*_):
        raise FileNotFoundError("the returns are gone")

    monkeypatch.setattr("app.drives.stored_images.write_image_file", gone)
    seen, record = stages_of(store)
    assert seen == ["fitting"]
    assert record.parameters["calibrated"] is False


def drop_probes(store):
    [path] = store.layout.maps.rglob("images/*.h5")
    with h5py.File(path, "r+") as file:
        del file.attrs["probe_version"], file["probes"], file["probed"]
