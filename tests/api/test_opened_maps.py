"""Which maps a query that names none opens and keeps open."""

import pkgutil
from dataclasses import replace

import numpy as np
import pytest

from core.scans.scan import Scan
from tests.support.all_maps import ask, import_again, index_maps, packed, shared_basis
from tests.support.campus import PACKED
from tests.support.city import district
from tests.support.recording import KITTI, kitti
from tests.support.service import copy_of, problem_of, running


@pytest.mark.parametrize("anchored", [False, True])
def test_a_query_of_more_maps_than_are_kept_leaves_those_that_are(city, tmp_path, anchored):
    with running(copy_of(city, tmp_path / "data"), loaded_revisions=2) as client:
        on_earth = {"latitude_deg": 49.01, "longitude_deg": 8.4, "altitude_m": 115.0}
        anchor = {**on_earth, "heading_deg": 30.0}
        for slug in ("north", "west", "south") if anchored else ():
            client.patch(f"/v1/maps/{slug}", json={"anchor": anchor}).raise_for_status()
        body = kitti(district("south", noise_seed=5).scans[12])
        for slug in ("west", "south"):
            client.post(f"/v1/maps/{slug}/localizations/scan", content=body, headers=KITTI)
        kept = list(client.service.revisions._loaded)
        answer = ask(client, "scan", body, KITTI).json()
        assert answer["maps_searched"] == 3
        assert ("wgs84" in answer["best"]["pose"]) == anchored
        assert list(client.service.revisions._loaded) == kept


def test_the_second_of_two_queries_reads_no_map_and_measures_no_confidence(
    city, tmp_path, monkeypatch
):
    work = []

    def noted(name):
        module, _, function = name.rpartition(".")
        does = getattr(pkgutil.resolve_name(module), function)

        def done(*args):
            work.append(function)
            return does(*args)

        monkeypatch.setattr(name, done)

    noted("storage.store.revisions.read_revision")
    noted("core.mapping.limited_queries.LimitedScans.odds_gained")
    noted("core.mapping.limited_queries.LimitedSignatures.rescaling")
    points_m = district("south", noise_seed=5).scans[12].points_m
    quarter = kitti(Scan(points_m[points_m[:, 0] > np.abs(points_m[:, 1])]))
    with running(copy_of(city, tmp_path / "data"), loaded_revisions=2) as client:
        import_again(client, "north", "east")
        first = ask(client, "scan", quarter, KITTI).json()
        assert first["maps_searched"] == 4
        assert work.count("read_revision") == 4 + 1  # the first, when it was imported
        assert "odds_gained" in work
        work.clear()
        assert ask(client, "scan", quarter, KITTI).json() == first
        assert work == []


@pytest.mark.parametrize("kind", ["signature", "scan"])
def test_maps_that_vehicles_name_stay_in_memory(city, tmp_path, kind):
    with running(copy_of(city, tmp_path / "data"), loaded_revisions=2) as client:
        body = kitti(district("south", noise_seed=5).scans[12])
        for slug in ("west", "north"):
            client.post(f"/v1/maps/{slug}/localizations/scan", content=body, headers=KITTI)
        kept = list(client.service.revisions._loaded)
        basis = shared_basis(client)  # of two maps: as many as are kept
        signature = packed(basis, district("south", noise_seed=5).scans[12])
        sent = (signature, PACKED) if kind == "signature" else (body, KITTI)
        assert ask(client, kind, *sent).json()["map"] == "south"
        assert list(client.service.revisions._loaded) == kept


def test_a_map_that_does_not_fit_leaves_the_room_to_others(city, tmp_path, monkeypatch):
    with running(copy_of(city, tmp_path / "data"), opened_scans=100) as client:
        search = client.service.all_maps
        summaries = client.service.store.catalog.map_summaries.all()
        scans = {"north": 101, "south": 60, "west": 50}
        maps = [replace(of, scans=scans[of.slug]) for of in summaries if of.slug in scans]
        live, kept = search._open_maps.live, {}

        def noted(summary, *, keep):
            kept[summary.slug] = keep
            return live(summary, keep=keep)

        monkeypatch.setattr(search._open_maps, "live", noted)
        list(search._opened(maps, {}))
        assert kept == {"north": False, "south": True, "west": False}


def test_maps_that_are_not_indexed_yet_are_opened_or_listed(city, tmp_path, monkeypatch):
    with running(copy_of(city, tmp_path / "data"), max_maps_opened=1) as client:
        monkeypatch.setattr("app.localization.all_maps.FEWEST_MAPS", 2)
        monkeypatch.setattr(client.service.indexes, "wake", lambda *_: None)
        body = packed(shared_basis(client), district("north", noise_seed=5).scans[12])
        answer = ask(client, "signature", body, PACKED).json()
        assert (answer["map"], answer["maps_searched"]) == ("north", 1)
        assert {"map": "south", "reason": "not_indexed"} in answer["not_searched"]


def test_more_maps_than_may_be_opened_are_refused(city, tmp_path):
    with running(copy_of(city, tmp_path / "data"), max_maps_opened=2) as client:
        body = kitti(district("north").scans[0])
        assert problem_of(ask(client, "scan", body, KITTI)) == (422, "too-many-maps")


def test_of_maps_of_one_index_a_basis_is_not_advised_where_fewer_may_be_opened(
    city, tmp_path, monkeypatch
):
    with running(copy_of(city, tmp_path / "data"), max_maps_opened=1) as client:
        index_maps(client, monkeypatch)
        body = packed(shared_basis(client), district("north", noise_seed=5).scans[12])
        refused = ask(client, "signature", body, PACKED)
    assert problem_of(refused) == (422, "too-many-maps")
    advice = "the limit is 1: name a map, or raise TENSORMAP_MAX_MAPS_OPENED"
    assert refused.json()["detail"].endswith(advice)
