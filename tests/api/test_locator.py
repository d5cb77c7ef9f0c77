"""A vehicle with the client that does not know its map, on a service in this process."""

import asyncio

import numpy as np
import pytest
from httpx2 import ASGITransport
from tensormap_client import (
    AsyncLocator,
    InvalidArgument,
    Locator,
    Mounting,
    UnusableScan,
    Vehicle,
)
from tensormap_client.problems import BasisNotFound, MapNotFound, StaleSignature

from tests.support.access import ADMIN_KEY, LOCALIZE, holder
from tests.support.city import DISTRICTS, build_district, district
from tests.support.client_calls import HERE, counted, watched
from tests.support.recording import recording
from tests.support.service import copy_of, running


@pytest.fixture(scope="module")
def client(city, tmp_path_factory):
    with running(copy_of(city, tmp_path_factory.mktemp("located") / "data")) as client:
        yield client


@pytest.fixture
def own(city, tmp_path):
    with running(copy_of(city, tmp_path / "data")) as client:
        yield client


def locator_of(client, basis="city", **options):
    return Locator(HERE, None, basis, connections=client._transport, **options)


def query(slug, index):
    return district(slug, noise_seed=5).scans[index].points_m


def distance_m(match, slug, index):
    true = district(slug).pose(index)
    return np.hypot(match.pose.x_m - true.x_m, match.pose.y_m - true.y_m)


def test_a_scan_is_found_in_its_map_by_one_download_of_the_shared_basis(client):
    connections, requested = counted(client)
    with Locator(HERE, None, "city", connections=connections) as locator:
        for slug in ("north", "south", "north"):
            for index in (8, 24):
                found = locator.locate(query(slug, index), k=3)
                assert (found.map, found.best.map, found.localized) == (slug, slug, True)
                assert distance_m(found.best, slug, index) < 3.0
                assert found.best == found.matches[0]
                assert len(found.matches) == 3
                assert (found.maps_searched, found.maps_not_searched) == (2, 2)
                live = client.get(f"/v1/maps/{slug}").json()["live_revision"]
                assert found.best.revision == live
                assert found.raw["not_searched"][0]["map"] == "east"
    # The basis of a map has how many cells of an image it wants.
    first = [("signature", 200), ("basis", 200), ("signature", 200)]
    again = [("signature", 200), ("signature", 200)]
    assert requested == [("city", 200), *first, *first, *again]


def test_it_sends_all_numbers_that_maps_keep(client):
    sent = []
    connections = watched(client, lambda request, _: sent.append(request.content))
    points = query("north", 24)
    front = points[np.abs(np.arctan2(points[:, 1], points[:, 0])) < 1.0]
    with Locator(HERE, None, "city", connections=connections) as locator:
        for scan in (points, front):
            locator.locate(scan)
    assert [(len(body), *body[9:11]) for body in sent if body] == [(245, 10, 12), (251, 10, 12)]


def test_a_place_outside_all_maps_is_not_localized(client):
    with locator_of(client) as locator:
        for index in (5, 20, 35):
            found = locator.locate(recording().scans[index].points_m)
            assert not found.localized
            assert found.reason in {"unknown_place", "ambiguous"}
            assert found.best.map in DISTRICTS


def test_a_least_probability_is_that_of_the_caller(client):
    with locator_of(client) as locator:
        accepted = locator.locate(query("north", 24), min_probability=0.0)
        refused = locator.locate(query("north", 24), min_probability=1.0)
    assert 0.5 < accepted.probability < 1.0
    assert (accepted.localized, refused.localized) == (True, False)
    assert refused.best == accepted.best


def test_a_basis_that_is_not_there_is_an_error_of_its_name(client):
    with locator_of(client, "elsewhere") as locator, pytest.raises(BasisNotFound) as missing:
        locator.locate(query("north", 8))
    assert (missing.value.status, missing.value.problem) == (404, "basis-not-found")
    assert "'elsewhere'" in missing.value.detail
    with (
        locator_of(client, "no name?") as locator,
        pytest.raises(BasisNotFound, match="no name"),
    ):
        locator.locate(query("north", 8))


def test_a_basis_may_be_named_by_its_digest(client):
    digest = client.get("/v1/bases/city").json()["basis"]
    with locator_of(client, digest) as locator:
        assert locator.locate(query("south", 8)).map == "south"


@pytest.mark.parametrize("kind", [Locator, AsyncLocator, Vehicle])
def test_a_height_and_a_mounting_are_refused_together(kind):
    with pytest.raises(InvalidArgument, match="leave sensor_height_m out"):
        kind(HERE, None, "city", sensor_height_m=1.9, mounting=Mounting(0.0, 0.0, 1.9))


def test_a_mounting_makes_the_answer_the_vehicles_pose(client):
    yawed = query("north", 8)[:, [1, 0, 2]] * np.array([-1.0, 1.0, 1.0], np.float32)
    with (
        locator_of(client) as ahead,
        locator_of(client, mounting=Mounting(0.0, 0.0, 1.73, yaw_deg=-90.0)) as aside,
    ):
        one, other = ahead.locate(query("north", 8)), aside.locate(yawed)
    assert one.localized
    assert (other.map, other.best.scan_index) == (one.map, one.best.scan_index)
    assert abs(other.best.heading_deg - one.best.heading_deg) < 1.5


def test_a_scan_of_few_returns_is_not_sent(client):
    connections, requested = counted(client)
    with Locator(HERE, None, "city", connections=connections) as locator:
        with pytest.raises(UnusableScan, match="at least 100 wanted"):
            locator.locate(query("north", 8)[:99])
        assert requested == [("city", 200)]


def test_a_stale_basis_is_renewed_once_its_name_has_another(own):
    connections, requested = counted(own)
    shared = own.post("/v1/bases", json={"name": "town", "maps": ["west"]})
    assert shared.status_code == 201
    with Locator(HERE, None, "town", connections=connections) as locator:
        found = locator.locate(query("west", 8))
        assert (found.map, found.maps_searched) == ("west", 1)
        before = found.best.revision

        build_district(own, "west", basis="city", make_live=True, force=True)
        del requested[:]
        for _ in range(2):  # the name still has this basis, and no live revision does
            with pytest.raises(StaleSignature):
                locator.locate(query("west", 8))
        assert requested == [("signature", 409), ("town", 304)] * 2

        assert own.delete(f"/v1/maps/west/revisions/{before}").status_code == 204
        assert own.delete("/v1/bases/town").status_code == 204
        with pytest.raises(BasisNotFound):
            locator.locate(query("west", 8))
        shared = own.post("/v1/bases", json={"name": "town", "maps": ["north", "west"]})
        assert shared.status_code == 201
        build_district(own, "west", basis="town", make_live=True, force=True)
        del requested[:]
        for _ in range(2):
            found = locator.locate(query("west", 8))
            assert (found.map, found.localized) == ("west", True)
        assert requested == [
            *(("signature", 409), ("town", 200), ("signature", 200), ("basis", 200)),
            ("signature", 200),
        ]


def test_a_basis_that_is_stale_when_it_is_downloaded_is_not_downloaded_twice(own):
    own.post("/v1/bases", json={"name": "unused", "maps": ["north", "west"]})
    connections, requested = counted(own)
    with (
        Locator(HERE, None, "unused", connections=connections) as locator,
        pytest.raises(StaleSignature),
    ):
        locator.locate(query("north", 8))
    assert requested == [("unused", 200), ("signature", 409)]


def test_a_key_of_some_maps_is_answered_by_these(city, tmp_path):
    with running(copy_of(city, tmp_path / "data"), admin_key=ADMIN_KEY) as client:

        def locator_with(maps):
            [secret] = holder(client, LOCALIZE, maps=maps).values()
            key = secret.removeprefix("Bearer ")
            return Locator(HERE, key, "city", connections=client._transport)

        with locator_with(["south"]) as locator:
            found = locator.locate(query("north", 9))
            assert (found.map, found.localized, found.maps_searched) == ("south", False, 1)
        with locator_with(["elsewhere"]) as locator, pytest.raises(MapNotFound):
            locator.locate(query("north", 9))


def test_the_asynchronous_locator_answers_the_same(client):
    scans = [query("north", 8), query("south", 24), recording().scans[5].points_m]

    async def located():
        connections = ASGITransport(client.app, client=("127.0.0.1", 5000))
        async with AsyncLocator(HERE, None, "city", connections=connections) as locator:
            return [await locator.locate(scan, k=2) for scan in scans]

    with locator_of(client) as locator:
        assert asyncio.run(located()) == [locator.locate(scan, k=2) for scan in scans]

    async def missing():
        connections = ASGITransport(client.app, client=("127.0.0.1", 5000))
        async with AsyncLocator(HERE, None, "elsewhere", connections=connections) as locator:
            await locator.locate(scans[0])

    with pytest.raises(BasisNotFound):
        asyncio.run(missing())
