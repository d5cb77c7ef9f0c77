"""Comparisons of two revisions, with recall on their common scans."""

from typing import Any

import pytest

from app.builds.recall import MOST_QUERIES
from tests.support.campus import MAP, build
from tests.support.recording import Recording, recording
from tests.support.service import damage, problem_of, running, upload

HDF5 = {"Content-Type": "application/vnd.tensormap.map+hdf5"}
PLAIN = {"views": "full", "lateral_renderings_m": [0], "segment_length": 12}


@pytest.fixture(scope="module")
def campus(tmp_path_factory):
    """A map and its revisions by name: drives of the same places, and other parameters."""
    with running(tmp_path_factory.mktemp("compared") / "data") as client:
        client.post("/v1/maps", json={"map": "campus"})
        upload(client, "monday", recording())
        upload(client, "short", Recording(recording(noise_seed=5).scans[:6]))
        builds: dict[str, dict[str, Any]] = {
            "plain": {},
            "tiny": {"ranks": [1, 1]},
            "more": {"drives": ["monday", "short"]},
            "short": {"drives": ["short"]},
            "paper": {"encoding": "paper", "lateral_renderings_m": None},
        }
        revisions = {
            name: build(client, **{"drives": ["monday"], **PLAIN, **changes})["revision"]
            for name, changes in builds.items()
        }
        yield client, revisions


def compared(campus, this, other=None):
    client, revisions = campus
    query = {} if other is None else {"with": revisions[other][:16]}
    answer = client.get(f"{MAP}/revisions/{revisions[this]}/comparison", params=query)
    assert answer.status_code == 200, answer.text
    return answer.json()


def test_a_revision_is_identical_to_itself(campus):
    found = compared(campus, "plain", "plain")
    assert found["identical"]
    assert found["same_basis"]
    assert found["this"] == found["other"]
    assert found["changed_parameters"] == []
    assert found["drives"] == [{"drive": "monday", "in_both": 48, "only_this": 0, "only_other": 0}]
    assert (found["scans_in_both"], found["scans_only_this"], found["scans_only_other"]) == (
        48,
        0,
        0,
    )
    recall = found["recall"]
    assert recall["same_questions"]
    assert 30 < recall["asked"] <= MOST_QUERIES
    assert recall["this"] == recall["other"] > 0.6
    assert found["recall_unknown"] is None


def test_signatures_of_one_number_have_a_lower_recall(campus):
    found = compared(campus, "tiny")  # with the live one
    revisions = campus[1]
    assert found["other"]["revision"] == revisions["plain"]
    assert not found["identical"]
    assert not found["same_basis"]
    assert found["changed_parameters"] == [{"name": "ranks", "this": [1, 1], "other": [5, 5]}]
    assert found["scans_in_both"] == 48
    assert found["recall"]["same_questions"]
    assert found["recall"]["this"] < found["recall"]["other"] - 0.1
    assert found["this"]["relative_error_median"] > found["other"]["relative_error_median"]
    assert found["this"]["size_bytes"] < found["other"]["size_bytes"]
    swapped = compared(campus, "plain", "tiny")
    assert (swapped["this"], swapped["other"]) == (found["other"], found["this"])
    assert swapped["recall"] == {
        **found["recall"],
        "this": found["recall"]["other"],
        "other": found["recall"]["this"],
    }
    assert compared(campus, "tiny") == found  # it depends on nothing else


def test_the_numbers_are_those_of_the_revision_and_its_graph(campus):
    found = compared(campus, "plain")["this"]
    client, revisions = campus
    record = client.get(f"{MAP}/revisions/{revisions['plain']}").json()
    for name in ("revision", "scans", "segments", "size_bytes", "created_at"):
        assert found[name] == record[name]
    graph = client.get(f"{MAP}/topology", params={"revision": revisions["plain"]}).json()
    assert (found["nodes"], found["edges"]) == (len(graph["nodes"]), len(graph["edges"]))
    assert found["length_m"] == pytest.approx(sum(edge["length_m"] for edge in graph["edges"]))
    assert (
        found["calibrated"]
        == record["parameters"]["calibrated"]
        == (found["threshold"] is not None)
    )


def test_an_added_drive_is_listed_and_the_common_scans_are_queries(campus):
    found = compared(campus, "more", "plain")
    assert found["same_basis"]  # it was kept
    assert found["changed_parameters"] == []
    assert found["drives"] == [
        {"drive": "monday", "in_both": 48, "only_this": 0, "only_other": 0},
        {"drive": "short", "in_both": 0, "only_this": 6, "only_other": 0},
    ]
    assert found["recall"]["asked"] == compared(campus, "plain")["recall"]["asked"]
    assert compared(campus, "short", "plain")["recall_unknown"] == "no-scan-in-both"


def test_maps_that_answer_other_places_have_other_queries(campus):
    found = compared(campus, "paper", "plain")
    assert not found["recall"]["same_questions"]
    changed = {item["name"]: (item["this"], item["other"]) for item in found["changed_parameters"]}
    assert changed["encoding"] == ("paper", "harmonic")
    assert changed["lateral_renderings_m"] == (None, [0.0])
    assert found["this"]["drives"] == found["other"]["drives"] == ["monday"]


def test_the_recall_of_an_imported_revision_is_unknown(campus):
    client, revisions = campus
    body = client.get(f"{MAP}/revisions/{revisions['plain']}/file").content
    client.post("/v1/maps", json={"map": "elsewhere"})
    client.post("/v1/maps/elsewhere/revisions", content=body, headers=HDF5)
    found = client.get(f"/v1/maps/elsewhere/revisions/{revisions['plain']}/comparison").json()
    assert found["identical"]
    assert (found["recall"], found["recall_unknown"]) == (None, "not-built-here")
    assert found["scans_in_both"] == 48


def test_a_drive_created_again_has_other_scans_and_without_images_recall_is_unknown(tmp_path):
    with running(tmp_path / "data") as client:
        client.post("/v1/maps", json={"map": "campus"})

        def one(noise_seed):
            upload(client, "monday", Recording(recording(noise_seed=noise_seed).scans[:8]))
            return build(client, **PLAIN)["revision"]

        revisions = {"first": one(0)}
        client.delete(f"{MAP}/drives/monday")
        found = compared((client, revisions), "first", "first")
        assert (found["recall"], found["recall_unknown"]) == (None, "images-not-kept")
        revisions["second"] = one(1)
        found = compared((client, revisions), "second", "first")
        assert found["drives"] == [
            {"drive": "monday", "in_both": 0, "only_this": 8, "only_other": 8}
        ]
        assert found["recall_unknown"] == "no-scan-in-both"
        store = client.service.store
        drive = store.drives.get("campus", "monday")
        for path in store.layout.images(drive.map_id, drive.id).iterdir():
            damage(path, path.read_bytes()[:100])
        assert compared((client, revisions), "second", "second")["recall_unknown"] == (
            "images-not-kept"
        )


def test_an_unknown_revision_is_refused_with_its_problem(campus):
    client, revisions = campus
    known = f"{MAP}/revisions/{revisions['plain']}/comparison"
    refused = client.get(known, params={"with": "0" * 64})
    assert problem_of(refused) == (404, "revision-not-found")
    refused = client.get(f"{MAP}/revisions/{'0' * 64}/comparison")
    assert problem_of(refused) == (404, "revision-not-found")
    client.post("/v1/maps", json={"map": "bare"})
    refused = client.get(f"/v1/maps/bare/revisions/{'0' * 64}/comparison")
    assert problem_of(refused) == (409, "no-live-revision")
