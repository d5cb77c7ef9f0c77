"""Contents of imported maps: a route can answer with every live map."""

import io
import json

import h5py
import numpy as np
import pytest

import core.scans.trajectory
import storage.files.map_file
from core.revision import content_digest
from tests.support.campus import MAP
from tests.support.recording import KITTI, kitti, recording
from tests.support.service import copy_of, problem_of, running, whole_store

NPZ = "application/vnd.tensormap.basis+npz"
HDF5 = {"Content-Type": "application/vnd.tensormap.map+hdf5"}
SCAN = recording(noise_seed=7).scans[4]


@pytest.fixture(scope="module")
def exported(client, built):
    return client.get(f"{MAP}/revisions/{built.live}/file").content


@pytest.fixture(scope="module")
def open_service(tmp_path_factory):
    """A service with an empty map, for imports that may not leave a trace."""
    with running(tmp_path_factory.mktemp("odd") / "data") as client:
        client.post("/v1/maps", json={"map": "campus"})
        yield client


def odd(body, arrays=(), **attributes):
    """Return a map's file with other numbers and attributes, and the digest that fits them."""
    file = io.BytesIO(body)
    with h5py.File(file, "r+") as opened:
        for name, change in dict(arrays).items():
            opened[name][...] = change(opened[name][()])
        held = json.loads(opened.attrs["attributes"]) | attributes
        opened.attrs["attributes"] = json.dumps(held, sort_keys=True)
        opened.attrs["digest"] = content_digest({n: opened[n][()] for n in opened}, held)
    return file.getvalue()


def put(client, body):
    return client.post(f"{MAP}/revisions", content=body, headers=HDF5)


def answers_of_read_routes(client):
    """Return the status of every route that reads the live revision, by name."""
    scan = {"content": kitti(SCAN), "headers": KITTI}
    answers = {
        "maps": client.get("/v1/maps"),
        "map": client.get(MAP),
        "revisions": client.get(f"{MAP}/revisions"),
        "drives": client.get(f"{MAP}/drives"),
        "basis": client.get(f"{MAP}/basis"),
        "npz": client.get(f"{MAP}/basis", headers={"Accept": NPZ}),
        "topology": client.get(f"{MAP}/topology"),
        "scan": client.post(f"{MAP}/localizations/scan", **scan),
        "track": client.post(f"{MAP}/tracks"),
        "jobs": client.get("/v1/jobs"),
        "audit": client.get("/v1/audit"),
    }
    digest = answers["map"].json()["live_revision"]
    if digest:
        one = f"{MAP}/revisions/{digest}"
        answers["revision"] = client.get(one)
        answers["file"] = client.get(f"{one}/file")
        answers["comparison"] = client.get(f"{one}/comparison", params={"with": digest})
    if answers["track"].status_code == 201:
        track = f"{MAP}/tracks/{answers['track'].json()['track']}"
        answers["observation"] = client.post(f"{track}/observations", **scan)
        answers["observed"] = client.get(track)
    return {name: answer.status_code for name, answer in answers.items()}


NAMES = {
    "a lone surrogate": "monday\ud800",
    "a line break": "mon\nday",
    "a zero byte": "mon\0day",
    "an escape": "\x1b[31mmonday",
    "a turned direction": "mon\u202eyad",
    "nothing": "",
    "too long": "m" * 256,
    "a number": 7,
    "a list": ["monday"],
    "null": None,
}


@pytest.mark.parametrize("name", NAMES.values(), ids=NAMES.keys())
def test_a_drive_whose_name_is_no_text_is_refused_and_nothing_is_stored(
    open_service, exported, name
):
    before = whole_store(open_service)
    answer = put(open_service, odd(exported, drives=[name]))
    assert problem_of(answer) == (422, "invalid-map")
    assert whole_store(open_service) == before
    assert answers_of_read_routes(open_service)["topology"] == 409


ODD = {
    "indices that JSON cannot hold": ({"scan_index": lambda a: a + 2**53}, {}),
    "an infinite time": ({"timestamp_s": lambda a: np.full_like(a, np.inf)}, {}),
    "a time beyond sense": ({"timestamp_s": lambda a: np.full_like(a, -1.7e308)}, {}),
    "a pose beyond the Earth": ({"pose": lambda a: np.add(a, [1e9, 0, 0, 0, 0, 0, 0])}, {}),
    "a quaternion of length 2": ({"pose": lambda a: a * [1, 1, 1, 2, 2, 2, 2]}, {}),
    "half a pose": ({"pose": lambda a: np.add(a, [np.nan, 0, 0, 0, 0, 0, 0])}, {}),
    "a node that is no scan": ({"node_scan": lambda a: a + 10**6}, {}),
    "an edge without a node": ({"edge_nodes": lambda a: a + 10**6}, {}),
    "an endless edge": ({"edge_length_m": lambda a: np.full_like(a, 1e308)}, {}),
    "an error above 1": ({"relative_error": lambda a: a + 1}, {}),
    "signatures that are no numbers": ({"signatures": lambda a: a * np.nan}, {}),
    "signatures of all that float32 has": ({"signatures": lambda a: np.full_like(a, 3e38)}, {}),
    "bases that are none": ({"azimuth_basis": lambda a: a + 9}, {}),
    "bases of nothing": ({"elevation_basis": lambda a: a * 0}, {}),
    "bases that are not orthonormal": ({"elevation_basis": lambda a: np.full_like(a, 1.0)}, {}),
    "a segment without scans": ({"segment_start": lambda a: a * 0}, {}),
    "a drive that is too long": ({"drive_start": lambda a: a * 2}, {}),
    "a sensor that is no name": ({}, {"sensor": "hdl\ud800"}),
    "a sensor of a page": ({}, {"sensor": "x" * 10_000}),
    "a sensor without height": ({}, {"sensor_height_m": 0.0}),
    "ranks without end": ({}, {"ranks": [10**30, 5]}),
    "a grid without end": ({}, {"grid": {"rings": 10**9}}),
    "an unknown attribute": ({}, {"more": "\ud800"}),
    "a calibration of its own": ({}, {"calibration": {"floor": -1}}),
    "a calibration beyond sense": (
        {},
        {
            "calibration": {
                "floor": 1.0,
                "both": [1e308, -1e308, -1e308],
                "alone": [1e308, -1e308],
                "likelihood": [1e308, -1e308],
                "threshold": 0.5,
                "least_cells": 0,
                "spread": None,
            }
        },
    ),
}


@pytest.mark.parametrize(("arrays", "attributes"), ODD.values(), ids=ODD.keys())
def test_an_impossible_map_is_rejected_and_nothing_is_stored(
    open_service, exported, arrays, attributes
):
    before = whole_store(open_service)
    assert problem_of(put(open_service, odd(exported, arrays, **attributes))) == (
        422,
        "invalid-map",
    )
    assert whole_store(open_service) == before


EXTREME = {
    "as it is": ({}, {}),
    "a name in another script": ({}, {"drives": ["Straße 七"]}),
    "the last indices": ({"scan_index": lambda a: a + 2**53 - 1 - a.max()}, {}),
    "times far away": ({"timestamp_s": lambda a: a - 1e299}, {}),
    "times unknown": ({"timestamp_s": lambda a: a * np.nan}, {}),
    "poses unknown": ({"pose": lambda a: a * np.nan}, {}),
    "poses far away": ({"pose": lambda a: np.add(a, [9e7, -9e7, 9e7, 0, 0, 0, 0])}, {}),
    "signatures of nothing": ({"signatures": lambda a: a * 0}, {}),
    "signatures as large as may be": ({"signatures": lambda a: np.full_like(a, 9e11)}, {}),
    "the sharpest calibration": (
        {},
        {
            "calibration": {
                "floor": 5e-324,
                "both": [1e12, -1e12, -1e12],
                "alone": [-1e12, -1e12],
                "likelihood": [1e12, -1e12],
                "threshold": 0.0,
                "least_cells": 0,
                "spread": {
                    "typical": 1e-30,
                    "along_m": [1e12, 1e12],
                    "lateral_m": [1e12, 1e12],
                    "heading_deg": [1e12, 1e12],
                },
            }
        },
    ),
}


@pytest.mark.parametrize(("arrays", "attributes"), EXTREME.values(), ids=EXTREME.keys())
def test_every_route_answers_with_whatever_map_was_let_in(tmp_path, exported, arrays, attributes):
    with running(tmp_path / "data") as client:
        client.post("/v1/maps", json={"map": "campus"})
        answer = put(client, odd(exported, arrays, **attributes))
        assert answer.status_code == 201, answer.text
        statuses = answers_of_read_routes(client)
    assert not {name: status for name, status in statuses.items() if status >= 500}, statuses


def test_a_name_that_an_earlier_version_let_in_is_refused_by_name_and_the_rest_answers(
    tmp_path, built, exported, monkeypatch
):
    data_dir = copy_of(built.data_dir, tmp_path / "data")
    with running(data_dir) as client, monkeypatch.context() as earlier:
        earlier.setattr(core.scans.trajectory, "flaw_in", lambda *_: None)
        earlier.setattr(storage.files.map_file, "parse_json", lambda text, _: json.loads(text))
        client.post("/v1/maps", json={"map": "old"})
        body = odd(exported, drives=["monday\ud800"])
        client.post("/v1/maps/old/revisions", content=body, headers=HDF5)
    with running(data_dir) as client:
        listed = client.get("/v1/maps/old/revisions")
        assert listed.status_code == 200
        assert listed.json()["items"][0]["parameters"]["drives"] == ["monday?"]
        assert problem_of(client.get("/v1/maps/old/topology")) == (500, "corrupt-file")
        statuses = answers_of_read_routes(client)
    assert set(statuses.values()) == {200, 201}, statuses


@pytest.mark.parametrize("text", ["a\ud800", "a\0", "a\x1b[2J"])
def test_texts_that_cannot_be_shown_are_refused_wherever_they_come_in(open_service, text):
    bodies = {
        "/v1/maps": {"map": "other", "description": text},
        "/v1/keys": {"name": text, "scopes": ["maps:read"]},
    }
    for path, body in bodies.items():
        content = json.dumps(body).encode()
        answer = open_service.post(
            path, content=content, headers={"Content-Type": "application/json"}
        )
        assert problem_of(answer) == (422, "invalid-request"), (path, answer.text)
