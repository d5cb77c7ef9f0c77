"""A build is planned once: from heads of files, in the state when it was queued."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from app.builds.parameters import BuildParameters
from app.builds.placed_poses import kept_placements
from app.builds.plans import Plan, plan_build
from app.builds.revision_build import build_revision
from core.errors import InvalidParameters
from core.mapping.placement import Placement
from core.projection.imager import Views
from storage.catalog import RevisionFacts
from storage.catalog.models import Drive
from storage.errors import CorruptFile, DriveNotFound, RevisionNotFound
from storage.files.map_file import write_map
from storage.hdf5.dataset import ContiguousDataset
from tests.support.recording import recording


@pytest.fixture
def store(store):
    put(store, "monday")
    return store


@pytest.fixture
def map_id(store):
    return store.maps.get("campus").id


def put(store, drive):
    store.drives.put_scans("campus", drive, list(enumerate(recording().scans[:8])))


def test_a_plan_names_the_drives_the_basis_and_every_parameter(store, map_id):
    first = plan_build(store, map_id, BuildParameters(segments=2))
    assert (first.drives, first.basis_kept_from) == (["monday"], None)
    assert (first.parameters.segments, first.parameters.reducer) == (2, "highest")
    live = build_revision(store, map_id, first).digest
    put(store, "alpha")
    again = plan_build(store, map_id, BuildParameters(base="live", add=["alpha"]))
    assert (again.drives, again.basis_kept_from) == (["monday", "alpha"], live)
    assert again.parameters.base == live
    refitted = plan_build(store, map_id, BuildParameters(segments=2, refit=True))
    other_grid = plan_build(store, map_id, BuildParameters(image="range"))
    assert refitted.basis_kept_from is other_grid.basis_kept_from is None


def test_a_plan_reads_no_facts_of_single_scans(store, map_id, monkeypatch):
    """Of a million scans that takes a second, each time."""
    monkeypatch.setattr("storage.catalog.drives._counted", None)  # it is not called
    assert plan_build(store, map_id, BuildParameters()).drives == ["monday"]


def age(store, drive, days):
    with store.catalog._database.writing() as session:
        row = session.query(Drive).filter_by(slug=drive).one()
        row.created_at = datetime.now(UTC) - timedelta(days=days)


LEFT_OUT = "is left out, its upload began more than 30 days ago"


def test_a_drive_of_the_base_that_is_too_old_to_be_read_anew_is_left_out_and_noted(store, map_id):
    put(store, "alpha")
    build_revision(store, map_id, plan_build(store, map_id, BuildParameters(segments=2)))
    age(store, "monday", 40)
    both = BuildParameters(base="live", add=["alpha", "monday"], max_age_days=30)
    plan = plan_build(store, map_id, both)
    assert plan.drives == ["alpha"]
    assert plan.notes == [
        "drive alpha is in the base already: its scans are read, and its poses placed, anew",
        f"drive monday {LEFT_OUT}",
    ]


def test_a_drive_that_is_left_out_by_its_age_is_noted_only_if_the_request_names_it(store, map_id):
    put(store, "alpha")
    age(store, "monday", 40)
    named = BuildParameters(drives=["monday", "alpha"], segments=2, max_age_days=30)
    plan = plan_build(store, map_id, named)
    assert (plan.drives, plan.notes) == (["alpha"], [f"drive monday {LEFT_OUT}"])
    plan = plan_build(store, map_id, BuildParameters(segments=2, max_age_days=30))
    assert (plan.drives, plan.notes) == (["alpha"], [])


@pytest.mark.parametrize("cut", [{"segments": 8}, {"segment_length": 1}])
def test_segments_of_one_scan_are_not_planned(store, map_id, cut):
    with pytest.raises(InvalidParameters, match=f"{min(cut)} is .*the longest drive has 8 scans"):
        plan_build(store, map_id, BuildParameters(**cut))


def test_scans_that_become_one_are_counted_as_the_map_has_them(store, map_id):
    store.drives.put("campus", "paired", None, 2)
    store.drives.put_scans("campus", "paired", list(enumerate(recording().scans[:7])))
    plan = plan_build(store, map_id, BuildParameters(drives=["paired"], segments=2))
    built = build_revision(store, map_id, plan)
    assert (built.scans, built.segments) == (4, 2)
    with pytest.raises(InvalidParameters, match="segments is 3, the longest drive has 4 scans"):
        plan_build(store, map_id, BuildParameters(drives=["paired"], segments=3))


def test_a_drive_is_added_to_a_base_of_one_scan(store, map_id):
    store.drives.put_scans("campus", "single", list(enumerate(recording().scans[:1])))
    single = plan_build(store, map_id, BuildParameters(drives=["single"], segment_length=1))
    assert build_revision(store, map_id, single).parameters["segment_length"] == 1
    plan = plan_build(store, map_id, BuildParameters(base="live", add=["monday"]))
    assert plan.drives == ["single", "monday"]


def test_a_build_whose_kept_basis_is_gone_says_how_one_is_made_nevertheless(store, map_id):
    live = build_revision(store, map_id, plan_build(store, map_id, BuildParameters(segments=2)))
    plan = plan_build(store, map_id, BuildParameters(segments=2))
    assert plan.basis_kept_from == live.digest
    store.revisions.path_of(live).unlink()
    with pytest.raises(CorruptFile, match=r"is gone.*refit: true"):
        build_revision(store, map_id, plan)


@pytest.mark.parametrize(
    ("stored", "damaged"),
    [(b"[5000.0,", b"[4000.0,"), (b'"placements"', b'"placemen4s"')],
)
def test_a_build_is_not_based_on_a_file_whose_placements_were_changed(
    store, map_id, stored, damaged
):
    """The text of attributes has no checksum, and a plan reads no array to take the digest."""
    built = build_revision(store, map_id, plan_build(store, map_id, BuildParameters(segments=2)))
    moved = Placement((0.0, 0.0, 0.0, 1.0), (5000.0, 0.0, 0.0))
    placed = replace(store.revisions.read(built), placements={"monday": moved})
    parameters = {**built.parameters, "placements": placed.attributes()["placements"]}
    base = store.revisions.add(
        map_id,
        placed.revision,
        lambda path: write_map(path, placed),
        RevisionFacts(built.encoding, built.scans, built.segments, parameters),
        make_live=True,
    )
    on_base = BuildParameters(base="live", refit=True)
    assert plan_build(store, map_id, on_base).placements["monday"]["translation_m"][0] == 5000.0
    path = store.revisions.path_of(base)
    content = path.read_bytes()
    assert content.count(stored) == 1
    path.write_bytes(content.replace(stored, damaged))
    with pytest.raises(CorruptFile, match="other placements of drives than it was stored with"):
        plan_build(store, map_id, on_base)


def test_a_drive_that_lay_beside_the_others_with_one_that_is_removed_or_moved_still_does(
    store, map_id
):
    for name in ("alpha", "beta"):
        put(store, name)
    built = build_revision(store, map_id, plan_build(store, map_id, BuildParameters(segments=2)))
    tensor_map = store.revisions.read(built)
    lies = Placement((0.0, 0.0, 0.0, 1.0), (5000.0, 0.0, 0.0))
    meets = replace(lies, others=("alpha",), matches=20)
    placed = replace(tensor_map, placements={"alpha": lies, "beta": meets})
    store.revisions.add(
        map_id,
        placed.revision,
        lambda path: write_map(path, placed),
        RevisionFacts(
            built.encoding,
            built.scans,
            built.segments,
            {**built.parameters, "placements": placed.attributes()["placements"]},
        ),
        make_live=True,
    )
    for changes in ({"remove": ["alpha"]}, {"add": ["alpha"]}):
        plan = plan_build(store, map_id, BuildParameters(base="live", **changes))
        assert plan.placements == {"beta": lies.as_attributes()}
    plan = plan_build(store, map_id, BuildParameters(base="live", remove=["monday"]))
    assert plan.placements == {"alpha": lies.as_attributes(), "beta": meets.as_attributes()}
    rest = store.revisions.read(build_revision(store, map_id, plan))
    assert rest.trajectory.drives == ("alpha", "beta")
    assert rest.drives_aside == set()
    other = {"last_scan": 3, "sha256": "of other poses"}
    plan = plan_build(store, map_id, BuildParameters(base="live", refit=True))
    plan = plan.model_copy(update={"placed_poses": {"alpha": other}})
    kept, [note] = kept_placements(plan, store.drives.open_of_map(map_id, plan.drives))
    assert kept == {"beta": lies}
    assert "alpha" in note


def test_to_plan_reads_no_array_of_the_live_map(store, map_id, monkeypatch):
    build_revision(store, map_id, plan_build(store, map_id, BuildParameters(segments=2)))

    def fail(*_):
        raise AssertionError("an array is read")

    monkeypatch.setattr(ContiguousDataset, "rows", fail)
    assert (
        plan_build(store, map_id, BuildParameters(base="live", refit=True)).basis_kept_from is None
    )
    assert plan_build(store, map_id, BuildParameters()).basis_kept_from is not None


def test_a_plan_is_the_same_after_it_was_stored(store, map_id):
    plan = plan_build(store, map_id, BuildParameters(lateral_renderings_m=[-2, 0, 2]))
    job = store.jobs.create("campus", {}, plan=plan.model_dump(mode="json"))
    assert Plan.model_validate(store.jobs.get(job.id).plan) == plan


def test_scans_added_after_the_plan_are_not_built(store, map_id):
    plan = plan_build(store, map_id, BuildParameters(segments=2))
    put(store, "tuesday")
    assert build_revision(store, map_id, plan).parameters["drives"] == ["monday"]


def test_a_build_fails_with_the_name_of_what_was_deleted_after_the_plan(store, map_id):
    first = build_revision(store, map_id, plan_build(store, map_id, BuildParameters(segments=2)))
    plan = plan_build(store, map_id, BuildParameters(segments=3))
    expected = BuildParameters(segments=3, refit=True, make_live=True, force=True)
    build_revision(store, map_id, plan_build(store, map_id, expected))
    store.revisions.delete("campus", first.digest)
    with pytest.raises(RevisionNotFound):
        build_revision(store, map_id, plan)
    put(store, "tuesday")
    plan = plan_build(store, map_id, BuildParameters(segments=3))
    store.drives.delete("campus", "tuesday")
    with pytest.raises(DriveNotFound):
        build_revision(store, map_id, plan)


@pytest.mark.parametrize(
    ("chosen", "noted"),
    [
        ({"sensor": "os1-64"}, True),
        ({"sensor": "os1-64", "sensor_height_m": 2.1}, False),
        ({"sensor": "os1-64", "encoding": "paper"}, False),
        ({"sensor": "hdl-64e"}, False),
    ],
)
def test_a_plan_notes_a_height_that_it_assumes(store, map_id, chosen, noted):
    plan = plan_build(store, map_id, BuildParameters(segments=2, **chosen))
    assert plan.parameters.sensor_height_m == chosen.get("sensor_height_m", 1.73)
    assert any("1.73 m above ground is assumed" in note for note in plan.notes) is noted


def test_a_build_on_a_base_takes_its_height_over_and_notes_nothing(store, map_id):
    first = plan_build(store, map_id, BuildParameters(segments=2, sensor="os1-64"))
    build_revision(store, map_id, first)
    put(store, "alpha")
    again = plan_build(store, map_id, BuildParameters(base="live", add=["alpha"]))
    assert (again.parameters.sensor_height_m, again.notes) == (1.73, [])


def test_a_map_keeps_the_views_of_its_live_revision_unless_others_are_requested(store, map_id):
    assert plan_build(store, map_id, BuildParameters()).parameters.views == Views.ANY
    whole = plan_build(store, map_id, BuildParameters(views=Views.FULL))
    live = build_revision(store, map_id, whole).digest
    again = plan_build(store, map_id, BuildParameters())
    assert (again.parameters.views, again.basis_kept_from) == (Views.FULL, live)
    assert again.parameters.ranks == (5, 5)
    changed = plan_build(store, map_id, BuildParameters(views=Views.ANY))
    assert (changed.parameters.views, changed.basis_kept_from) == (Views.ANY, None)
    for others in ({"image": "range"}, {"encoding": "paper"}):
        changed = plan_build(store, map_id, BuildParameters(**others))
        assert (changed.parameters.views, changed.basis_kept_from) == (Views.FULL, None)
    put(store, "alpha")
    on_base = plan_build(store, map_id, BuildParameters(base="live", add=["alpha"]))
    assert on_base.parameters.views == Views.FULL
    with pytest.raises(InvalidParameters, match="views is any, that of base"):
        plan_build(store, map_id, BuildParameters(base="live", add=["alpha"], views=Views.ANY))


def test_a_map_keeps_verification_images_as_its_live_revision_has_them(store, map_id):
    bare = BuildParameters(views=Views.ANY, verification_images=False)
    live = build_revision(store, map_id, plan_build(store, map_id, bare)).digest
    again = plan_build(store, map_id, BuildParameters())
    assert (again.parameters.verification_images, again.basis_kept_from) == (False, live)
    for chosen in ({"views": Views.ANY}, {"verification_images": True}):
        changed = plan_build(store, map_id, BuildParameters(**chosen))
        assert (changed.parameters.verification_images, changed.basis_kept_from) == (True, live)
    put(store, "alpha")
    on_base = plan_build(store, map_id, BuildParameters(base="live", add=["alpha"]))
    assert on_base.parameters.verification_images is False
    with pytest.raises(InvalidParameters, match="verification_images is True, that of base"):
        plan_build(
            store, map_id, BuildParameters(base="live", add=["alpha"], verification_images=True)
        )
    with pytest.raises(InvalidParameters, match="which wants views = any"):
        BuildParameters(views=Views.FULL, verification_images=True).map_parameters()


@pytest.mark.parametrize(
    ("shared", "wanted", "named"),
    [
        ({}, {"encoding": "paper"}, "encoding is paper, that of the shared basis"),
        ({}, {"image": "range"}, "image is range, that of the shared basis"),
        ({}, {"views": "full"}, "views is full, that of the shared basis"),
        ({"views": "full"}, {"views": "any"}, "views is any, that of the shared basis"),
        ({}, {"ranks": (12, 7)}, "ranks is [12, 7], that of the shared basis"),
        ({"views": "full"}, {"sensor_height_m": 2.0}, "sensor_height_m is 2.0, that of the shared"),
    ],
)
def test_a_shared_basis_that_does_not_fit_is_refused_by_the_parameter_that_was_given(
    store, map_id, shared, wanted, named
):
    made = build_revision(store, map_id, plan_build(store, map_id, BuildParameters(**shared)))
    store.bases.add("city", store.revisions.read(made).basis())
    with pytest.raises(InvalidParameters) as refused:
        plan_build(store, map_id, BuildParameters(basis="city", **wanted))
    assert str(refused.value).startswith(named)


def test_a_plan_of_a_release_that_knew_full_views_only_is_one_of_full_views(store, map_id):
    stored = plan_build(store, map_id, BuildParameters()).model_dump(mode="json")
    del stored["parameters"]["views"], stored["parameters"]["verification_images"]
    taken = Plan.model_validate(stored).parameters
    assert (taken.views, taken.verification_images) == (Views.FULL, False)


def test_a_plan_notes_a_drive_to_add_that_the_base_has(store, map_id):
    build_revision(store, map_id, plan_build(store, map_id, BuildParameters(segments=2)))
    put(store, "alpha")
    plan = plan_build(store, map_id, BuildParameters(base="live", add=["alpha", "monday"]))
    [note] = plan.notes
    assert note.startswith("drive monday is in the base already: its scans are read")
