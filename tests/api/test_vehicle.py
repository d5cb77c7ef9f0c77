"""A vehicle with the client, on a service in this process."""

import asyncio
import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest
import tensormap_client
from httpx2 import ASGITransport
from tensormap_client import (
    AsyncVehicle,
    ClientClosed,
    ClientError,
    Localization,
    LocalizationInMaps,
    Match,
    MatchInMap,
    Prior,
    Rejected,
    TooFewCells,
    TrackAnswer,
    UnsupportedMap,
    UnusableScan,
    Vehicle,
)
from tensormap_client._sync.sensing import MIN_RETURNS
from tensormap_client.problems import InvalidParameters, MapNotFound

from app.localization.query_schemas import PriorsIn
from app.settings import Settings
from tests.support.client_calls import HERE, counted
from tests.support.commands import ROOT
from tests.support.recording import kitti, recording
from tests.support.service import document

QUERIES = recording(noise_seed=7).scans


def vehicle_of(client, slug="campus", **options):
    return Vehicle(HERE, None, slug, connections=client._transport, **options)


def test_a_scan_is_localized_in_a_map_of_the_papers_encoding(client):
    with vehicle_of(client) as vehicle:
        found = vehicle.locate(QUERIES[20].points_m)
    assert (found.localized, found.best.drive, found.best.scan_index) == (True, "monday", 20)
    assert found.revision == found.live_revision
    assert found.best.pose is not None


def test_the_program_of_the_readme_localizes_a_scan(client, tmp_path, monkeypatch, capsys):
    text = (ROOT / "clients/python/README.md").read_text()
    [program, _] = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    Path("000017.bin").write_bytes(kitti(QUERIES[17]))

    def here(url, key, slug):
        assert (url, key) == ("https://maps.example", "a key")
        return vehicle_of(client, slug)

    monkeypatch.setattr(tensormap_client, "Vehicle", here)
    exec(program, {})
    assert capsys.readouterr().out == "True monday 17\n"


def test_a_basis_is_downloaded_once_and_again_when_another_is_live(own, built):
    connections, requested = counted(own)
    with Vehicle(HERE, None, "campus", connections=connections) as vehicle:
        for _ in range(2):
            vehicle.locate(QUERIES[20].points_m)
        assert requested == [("basis", 200), ("signature", 200), ("signature", 200)]
        for live in (built.other, built.live):
            own.put("/v1/maps/campus/live", json={"revision": live})
            del requested[:]
            first, then = (vehicle.locate(QUERIES[20].points_m) for _ in range(2))
            # The basis that it has is answered by the revision that has it.
            assert (first.revision == live, then.revision) == (False, live)
            assert then.localized
            status = 200 if live == built.other else 304
            assert requested == [("signature", 200), ("basis", status), ("signature", 200)]


def test_returns_that_are_none_are_left_out_and_a_scan_without_any_is_named(client):
    points = QUERIES[20].points_m
    none = np.array([[np.nan, 1.0, 2.0], [0.0, 0.0, 0.0], [np.inf, 1.0, 1.0]], np.float32)
    with vehicle_of(client) as vehicle:
        found = vehicle.locate(np.concatenate([none, points, none]))
        assert found == vehicle.locate(points)
        for useless in (none, np.empty((0, 3)), np.array([[0.0, 0.0, 9.0]])):
            with pytest.raises(UnusableScan):
                vehicle.locate(useless)
        with pytest.raises(UnusableScan, match=r"shape \(3,\)"):
            vehicle.locate(points[0])
        with pytest.raises(UnusableScan, match="transposed"):
            vehicle.locate(points.T)
        with pytest.raises(UnusableScan, match=r"^99 returns .* at least 100 wanted"):
            vehicle.locate(points[:99])
    with vehicle_of(client, min_returns=10) as vehicle, pytest.raises(TooFewCells):
        vehicle.locate(points[:99])
    assert Settings.model_fields["min_returns"].default == MIN_RETURNS


def test_a_problem_of_the_service_is_an_error_of_its_name(client):
    with vehicle_of(client, "elsewhere") as vehicle, pytest.raises(MapNotFound) as missing:
        vehicle.locate(QUERIES[0].points_m)
    assert (missing.value.status, missing.value.problem) == (404, "map-not-found")
    assert "'elsewhere'" in missing.value.detail
    with vehicle_of(client) as vehicle, pytest.raises(InvalidParameters, match="x_m"):
        vehicle.locate(QUERIES[0].points_m, y_m=1.0, position_sigma_m=2.0)
    assert issubclass(MapNotFound, Rejected)


def test_a_closed_client_is_an_error_of_its_name(client):
    vehicle = vehicle_of(client)
    track = vehicle.track()
    vehicle.locate(QUERIES[0].points_m)
    for _ in range(2):
        vehicle.close()
    for use in (vehicle.locate, track.observe):
        with pytest.raises(ClientClosed, match="closed: make another one"):
            use(QUERIES[0].points_m)
    assert issubclass(ClientClosed, ClientError)


def test_an_argument_that_the_service_does_not_have_is_a_type_error(client):
    with vehicle_of(client) as vehicle:
        with pytest.raises(TypeError, match="no argument 'min_probabilty', wanted"):
            vehicle.locate(QUERIES[0].points_m, min_probabilty=0.5)
        known = {"x_m": 1e6, "y_m": 1e6, "position_sigma_m": 1.0}
        assert vehicle.locate(QUERIES[0].points_m, **known).reason == "outside_prior"
    assert Prior.__annotations__.keys() == PriorsIn.model_fields.keys()


def test_the_answers_name_fields_that_the_service_has():
    schemas = document()["components"]["schemas"]
    for kind, name in (
        (Localization, "LocalizationOut"),
        (Match, "MatchOut"),
        (LocalizationInMaps, "AllMapsAnswerOut"),
        (MatchInMap, "MatchInMapOut"),
        (TrackAnswer, "TrackStepOut"),
    ):
        names = {field.name for field in dataclasses.fields(kind)} - {"raw"}
        assert names <= set(schemas[name]["properties"])


@pytest.mark.parametrize(
    "change", [{"encoding": "other"}, {"views": "rear"}, {"reducer": "second"}]
)
def test_a_map_that_this_version_does_not_know_is_named(client, monkeypatch, change):
    client.get("/v1/maps/campus/basis")  # the service, in this process, has read its file before
    read = json.loads
    monkeypatch.setattr(json, "loads", lambda text: read(text) | change)
    with vehicle_of(client) as vehicle, pytest.raises(UnsupportedMap, match=next(iter(change))):
        vehicle.locate(QUERIES[0].points_m)


def test_the_asynchronous_vehicle_answers_the_same(client):
    async def located():
        connections = ASGITransport(client.app, client=("127.0.0.1", 5000))
        async with AsyncVehicle(HERE, None, "campus", connections=connections) as vehicle:
            return await vehicle.locate(QUERIES[20].points_m)

    with vehicle_of(client) as vehicle:
        assert asyncio.run(located()) == vehicle.locate(QUERIES[20].points_m)
