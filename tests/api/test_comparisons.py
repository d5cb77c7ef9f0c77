"""What changed between two revisions, in recall on the map's own scans too."""

from typing import Any

import pytest

from app.revisions.recall import MOST_ASKED
from tests.support.campus import build
from tests.support.recording import Recording, recording
from tests.support.service import damage, problem_of, running, upload

MAP = "/v1/maps/campus"
HDF5 = {"Content-Type": "application/vnd.tensormap.map+hdf5"}
PLAIN = {"lateral_renderings_m": [0], "segment_length": 12}


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
            name: build(client, **{"drives": ["monday"], **PLAIN, **wanted})["revision"]
            for name, wanted in builds.items()
        }
        yield client, revisions


def compared(campus, this, other=None):
    client, revisions = campus
    asked = {} if other is None else {"with": revisions[other][:16]}
    answer = client.get(f"{MAP}/revisions/{revisions[this]}/comparison", params=asked)
    assert answer.status_code == 200, answer.text
    return answer.json()


def test_a_revision_is_not_changed_from_itself(campus):
    told = compared(campus, "plain", "plain")
    assert told["identical"]
    assert told["same_basis"]
    assert told["this"] == told["other"]
    assert told["changed_parameters"] == []
    assert told["drives"] == [{"drive": "monday", "in_both": 48, "only_this": 0, "only_other": 0}]
    assert (told["scans_in_both"], told["scans_only_this"], told["scans_only_other"]) == (48, 0, 0)
    recall = told["recall"]
    assert recall["same_questions"]
    assert 30 < recall["asked"] <= MOST_ASKED
    assert recall["this"] == recall["other"] > 0.6
    assert told["recall_unknown"] is None


def test_signatures_of_one_number_find_less_and_say_less(campus):
    told = compared(campus, "tiny")  # with the live one
    revisions = campus[1]
    assert told["other"]["revision"] == revisions["plain"]
    assert not told["identical"]
    assert not told["same_basis"]
    assert told["changed_parameters"] == [{"name": "ranks", "this": [1, 1], "other": [5, 5]}]
    assert told["scans_in_both"] == 48
    assert told["recall"]["same_questions"]
    assert told["recall"]["this"] < told["recall"]["other"] - 0.1
    assert told["this"]["relative_error_median"] > told["other"]["relative_error_median"]
    assert told["this"]["size_bytes"] < told["other"]["size_bytes"]
    turned = compared(campus, "plain", "tiny")
    assert (turned["this"], turned["other"]) == (told["other"], told["this"])
    assert turned["recall"] == {
        **told["recall"],
        "this": told["recall"]["other"],
        "other": told["recall"]["this"],
    }
    assert compared(campus, "tiny") == told  # it depends on nothing else


def test_the_numbers_are_those_of_the_revision_and_its_graph(campus):
    told = compared(campus, "plain")["this"]
    client, revisions = campus
    record = client.get(f"{MAP}/revisions/{revisions['plain']}").json()
    for name in ("revision", "scans", "segments", "size_bytes", "created_at"):
        assert told[name] == record[name]
    graph = client.get(f"{MAP}/topology", params={"revision": revisions["plain"]}).json()
    assert (told["nodes"], told["edges"]) == (len(graph["nodes"]), len(graph["edges"]))
    assert told["length_m"] == pytest.approx(sum(edge["length_m"] for edge in graph["edges"]))
    assert (
        told["calibrated"] == record["parameters"]["calibrated"] == (told["threshold"] is not None)
    )


def test_an_added_drive_is_told_and_the_scans_of_both_are_asked(campus):
    told = compared(campus, "more", "plain")
    assert told["same_basis"]  # it was kept
    assert told["changed_parameters"] == []
    assert told["drives"] == [
        {"drive": "monday", "in_both": 48, "only_this": 0, "only_other": 0},
        {"drive": "short", "in_both": 0, "only_this": 6, "only_other": 0},
    ]
    assert told["recall"]["asked"] == compared(campus, "plain")["recall"]["asked"]
    assert compared(campus, "short", "plain")["recall_unknown"] == "no-scan-in-both"


def test_maps_that_promise_other_places_are_asked_there_and_that_is_said(campus):
    told = compared(campus, "paper", "plain")
    assert not told["recall"]["same_questions"]
    changed = {item["name"]: (item["this"], item["other"]) for item in told["changed_parameters"]}
    assert changed["encoding"] == ("paper", "harmonic")
    assert changed["lateral_renderings_m"] == (None, [0.0])
    assert told["this"]["drives"] == told["other"]["drives"] == ["monday"]


def test_of_an_imported_revision_no_recall_is_claimed(campus):
    client, revisions = campus
    body = client.get(f"{MAP}/revisions/{revisions['plain']}/file").content
    client.post("/v1/maps", json={"map": "elsewhere"})
    client.post("/v1/maps/elsewhere/revisions", content=body, headers=HDF5)
    told = client.get(f"/v1/maps/elsewhere/revisions/{revisions['plain']}/comparison").json()
    assert told["identical"]
    assert (told["recall"], told["recall_unknown"]) == (None, "not-built-here")
    assert told["scans_in_both"] == 48


def test_a_drive_made_anew_has_other_scans_and_gone_images_ask_nothing(tmp_path):
    with running(tmp_path / "data") as client:
        client.post("/v1/maps", json={"map": "campus"})

        def one(noise_seed):
            upload(client, "monday", Recording(recording(noise_seed=noise_seed).scans[:8]))
            return build(client, **PLAIN)["revision"]

        revisions = {"first": one(0)}
        client.delete(f"{MAP}/drives/monday")
        told = compared((client, revisions), "first", "first")
        assert (told["recall"], told["recall_unknown"]) == (None, "images-not-kept")
        revisions["second"] = one(1)
        told = compared((client, revisions), "second", "first")
        assert told["drives"] == [
            {"drive": "monday", "in_both": 0, "only_this": 8, "only_other": 8}
        ]
        assert told["recall_unknown"] == "no-scan-in-both"
        store = client.service.store
        drive = store.drives.get("campus", "monday")
        for path in store.layout.images(drive.map_id, drive.id).iterdir():
            damage(path, path.read_bytes()[:100])
        assert compared((client, revisions), "second", "second")["recall_unknown"] == (
            "images-not-kept"
        )


def test_a_revision_that_is_not_there_is_refused_by_name(campus):
    client, revisions = campus
    known = f"{MAP}/revisions/{revisions['plain']}/comparison"
    refused = client.get(known, params={"with": "0" * 64})
    assert problem_of(refused) == (404, "revision-not-found")
    refused = client.get(f"{MAP}/revisions/{'0' * 64}/comparison")
    assert problem_of(refused) == (404, "revision-not-found")
    client.post("/v1/maps", json={"map": "bare"})
    refused = client.get(f"/v1/maps/bare/revisions/{'0' * 64}/comparison")
    assert problem_of(refused) == (409, "no-live-revision")
