"""Scans of which too little is in a map's image, as with a covered sensor, of signing vehicles."""

import asyncio
import io
from dataclasses import replace

import numpy as np
import pytest
from httpx2 import ASGITransport, BaseTransport, Response
from tensormap_client import AsyncLocator, AsyncVehicle, Locator, TooFewCells, UnusableScan, Vehicle

from core.scans.scan import Scan
from storage.files.map_file import write_map
from tests.support.campus import NPZ, localize_packed
from tests.support.city import district
from tests.support.client_calls import HERE, counted
from tests.support.recording import KITTI, kitti
from tests.support.service import copy_of, running

HDF5 = {"Content-Type": "application/vnd.tensormap.map+hdf5"}
BASIS = "/v1/maps/north/basis"
LEAST_CELLS = "TensorMap-Least-Cells"


@pytest.fixture(scope="module")
def client(city, tmp_path_factory):
    with running(copy_of(city, tmp_path_factory.mktemp("covered") / "data")) as client:
        yield client


@pytest.fixture
def own(city, tmp_path):
    with running(copy_of(city, tmp_path / "data")) as client:
        yield client


def covered(points_m):
    """Return what a sensor sees of 36 degrees ahead."""
    return points_m[np.abs(np.arctan2(points_m[:, 1], points_m[:, 0])) < 0.1 * np.pi]


WHOLE = district("north", noise_seed=5).scans[8].points_m
COVERED = covered(WHOLE)


class OlderService(BaseTransport):
    """Connections to a service that says nothing of `least_cells`."""

    def __init__(self, client):
        self._send = client._transport.handle_request

    def handle_request(self, request):
        answer = self._send(request)
        if LEAST_CELLS not in answer.headers:
            return answer
        body = io.BytesIO()
        if answer.status_code == 200:
            with np.load(io.BytesIO(answer.read()), allow_pickle=False) as file:
                np.savez(body, **{name: file[name] for name in file.files if name != "least_cells"})
        headers = {"ETag": answer.headers["ETag"]}
        return Response(answer.status_code, headers=headers, content=body.getvalue())


def refused(client):
    """Return the service's answer to the covered scan, of which it has the image."""
    body = kitti(Scan(COVERED))
    answer = client.post("/v1/maps/north/localizations/scan", content=body, headers=KITTI)
    return answer.json()


def test_a_covered_scan_is_not_sent_by_a_vehicle_and_says_why(client):
    assert refused(client)["reason"] == "too_few_returns"
    connections, requested = counted(client)
    with Vehicle(HERE, None, "north", connections=connections) as vehicle:
        with pytest.raises(TooFewCells, match=r"^too few returns: \d+ cells .* at least \d+$"):
            vehicle.locate(COVERED)
        assert requested == [("basis", 200)]
        assert vehicle.locate(WHOLE).localized
    assert issubclass(TooFewCells, UnusableScan)


def test_few_covered_scans_of_another_district_are_localized_even_if_they_are_sent(client):
    with Vehicle(HERE, None, "north", connections=client._transport) as vehicle:
        basis = vehicle.basis()
        scans = [covered(scan.points_m) for scan in district("west").scans]
        for scan in scans:
            with pytest.raises(TooFewCells):
                vehicle.locate(scan)
    signed = [replace(basis, least_cells=0).encode(scan) for scan in scans]
    answers = [localize_packed(client, one, "north").json() for one in signed]
    localized = sum(answer["localized"] for answer in answers)
    assert localized <= len(scans) / 10  # 25 of 40 before distances were rescaled, now 2


def test_the_basis_says_how_many_cells_a_map_wants(client):
    as_json, as_npz = client.get(BASIS), client.get(BASIS, headers=NPZ)
    least = client.service.revisions.live("north").localizer.map.calibration.least_cells
    assert least > 0
    assert as_json.json()["least_cells"] == least
    with np.load(io.BytesIO(as_npz.content), allow_pickle=False) as arrays:
        assert arrays["least_cells"] == least
    held = client.get(BASIS, headers={"If-None-Match": as_json.headers["ETag"]})
    assert held.status_code == 304
    for answer in (as_json, as_npz, held):
        assert answer.headers[LEAST_CELLS] == str(least)


def test_a_shared_basis_is_of_no_map_and_wants_no_cells(client):
    shared = client.get("/v1/bases/city")
    assert shared.json()["least_cells"] is None
    assert LEAST_CELLS not in shared.headers


def test_a_vehicle_of_an_older_service_goes_on_as_before(client):
    with Vehicle(HERE, None, "north", connections=OlderService(client)) as vehicle:
        assert vehicle.basis().least_cells == 0
        assert vehicle.locate(COVERED).best.drive == "monday"


def test_a_vehicle_takes_the_number_of_the_live_revision(own, tmp_path):
    live = own.service.revisions.live("north").localizer.map
    wanting = replace(live, calibration=replace(live.calibration, least_cells=5000))
    write_map(tmp_path / "wanting.h5", wanting)
    connections, requested = counted(own)
    with Vehicle(HERE, None, "north", connections=connections) as vehicle:
        assert vehicle.locate(WHOLE).localized
        body, query = (tmp_path / "wanting.h5").read_bytes(), {"make_live": True}
        added = own.post("/v1/maps/north/revisions", content=body, headers=HDF5, params=query)
        assert added.json()["live"]
        del requested[:]
        assert vehicle.locate(WHOLE).revision == wanting.revision  # the basis is the same
        with pytest.raises(TooFewCells, match="at least 5000"):
            vehicle.locate(WHOLE)
    assert requested == [("signature", 200), ("basis", 304)]


def test_a_covered_scan_that_a_search_of_all_maps_finds_is_not_localized(client):
    connections, requested = counted(client)
    with Locator(HERE, None, "city", connections=connections) as locator:
        with pytest.raises(TooFewCells, match="too few returns"):
            locator.locate(COVERED, min_probability=0.0)
        assert requested == [("city", 200), ("signature", 200), ("basis", 200)]
        assert locator.locate(WHOLE).localized
        assert requested[3:] == [("signature", 200)]


def test_the_asynchronous_client_does_not_localize_it_either(client):
    async def located(kind, name):
        connections = ASGITransport(client.app, client=("127.0.0.1", 5000))
        async with kind(HERE, None, name, connections=connections) as vehicle:
            await vehicle.locate(COVERED, min_probability=0.0)

    for kind, name in ((AsyncVehicle, "north"), (AsyncLocator, "city")):
        with pytest.raises(TooFewCells):
            asyncio.run(located(kind, name))
