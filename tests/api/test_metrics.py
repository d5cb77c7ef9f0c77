"""Metrics: events are counted, and no label grows with the stored data."""

import math
import shutil

import pytest
from prometheus_client.parser import text_string_to_metric_families

from storage.errors import StorageUnavailable
from tests.support.captures import hdl32, pcap, udp
from tests.support.recording import KITTI, kitti, recording, upload_scan
from tests.support.service import problem_of, upload, wait_for


def metrics_of(client):
    """Return every sample by its name and labels."""
    answer = client.get("/metrics")
    assert answer.status_code == 200
    return {
        (sample.name, *sorted(sample.labels.values())): sample.value
        for family in text_string_to_metric_families(answer.text)
        for sample in family.samples
    }


def test_requests_are_counted_by_route_method_and_status_only(own):
    names = ["campus", "nowhere", "also-nowhere", "%2e%2e", "x" * 300]
    for name in names:
        own.get(f"/v1/maps/{name}")
    own.request("BREW", "/v1/maps/campus")
    own.get("/v1/nothing/of/the/kind")
    own.get("/docs")
    found = metrics_of(own)
    assert found["tensormap_http_requests_total", "/v1/maps/{map}", "200", "GET"] == 1
    assert found["tensormap_http_requests_total", "/v1/maps/{map}", "404", "GET"] >= 2
    assert found["tensormap_http_requests_total", "(none)", "404", "GET"] >= 1
    assert found["tensormap_http_requests_total", "/v1/maps/{map}", "405", "OTHER"] == 1
    assert found["tensormap_http_request_seconds_count", "/v1/maps/{map}", "GET"] >= 3
    assert found["tensormap_http_request_seconds_sum", "/v1/maps/{map}", "GET"] > 0
    answer = own.get("/metrics").text
    assert not any(name in answer for name in (*names[:3], "BREW", "monday"))


def test_a_series_has_no_second_one_of_when_it_began(own):
    assert not [key for key in metrics_of(own) if key[0].endswith("_created")]


def test_routes_are_the_documented_ones(own):
    own.get("/v1/maps/campus/drives/monday/scans/3")
    own.get("/problems/map-not-found")
    documented = set(own.documented["paths"])
    counted = metrics_of(own).items()
    routes = {
        key[1] for key, times in counted if key[0] == "tensormap_http_requests_total" and times
    }
    assert {"/v1/maps/{map}/drives/{drive}/scans/{index}", "/problems/{name}"} <= routes
    assert routes <= documented


def test_scans_builds_localizations_tracks_and_bytes_are_counted(empty):
    before = metrics_of(empty)
    assert before["tensormap_scans_stored_total",] == 0
    assert (before["tensormap_tracks",], before["tensormap_jobs", "queued"]) == (0, 0)
    drive = recording(scans=12)
    upload(empty, "monday", drive)
    assert upload_scan(empty, "campus", "monday", 0, drive.scans[0]).status_code == 200
    job = empty.post("/v1/maps/campus/builds", json={"segments": 2}).json()["job"]
    assert wait_for(empty, job)["state"] == "done"
    job = empty.post("/v1/maps/campus/builds", json={"segments": 2, "ranks": [5, 5]}).json()["job"]
    wait_for(empty, job)
    track = empty.post("/v1/maps/campus/tracks").headers["Location"]
    for scan in drive.scans[:2]:
        for path in ("/v1/maps/campus/localizations/scan", f"{track}/observations"):
            answer = empty.post(path, content=kitti(scan), headers=KITTI)
            assert answer.status_code == 200
    found = settled(empty, ("tensormap_builds_total", "done"), 2)
    assert found["tensormap_scans_stored_total",] == 12
    assert found["tensormap_build_seconds_count", "done"] == 2
    assert found["tensormap_build_seconds_sum", "done"] > 0
    localizations = {k: v for k, v in found.items() if k[0] == "tensormap_localizations_total"}
    assert sum(v for k, v in localizations.items() if "scan" in k) == 2
    assert sum(v for k, v in localizations.items() if "track" in k) == 2
    assert found["tensormap_tracks",] == 1
    assert found["tensormap_disk_free_bytes",] > 0
    assert found["process_resident_memory_bytes",] > 0
    # Added up before, and kept for half a minute.
    assert found["tensormap_store_bytes", "scans"] == 0
    sizes = empty.service.store.stored_bytes()
    assert sizes["scans"] == 12 * sum(len(scan) for scan in drive.scans)
    assert sizes["revisions"] == sum(
        path.stat().st_size
        for path in empty.service.settings.data_dir.glob("maps/*/revisions/*.h5")
    )


def test_the_scans_of_a_capture_are_counted_as_stored_once(empty):
    content = pcap([frame for payload in hdl32(turns=3.2) for frame in udp(payload, 2368)])
    files = [{"name": "monday.pcap", "size_bytes": len(content)}]
    drive = "/v1/maps/campus/drives/monday"
    for stored in (3, 0):
        capture = empty.post(f"{drive}/captures", json={"files": files, "part_bytes": 2**24}).json()
        url = f"{drive}/captures/{capture['capture']}"
        assert empty.put(f"{url}/parts/0", content=content).status_code == 201
        job = empty.patch(url, json={"complete": True}).json()["job"]
        assert wait_for(empty, job)["state"] == "done"
        assert empty.get(url).json()["scans"]["stored"] == stored
        settled(empty, ("tensormap_scans_stored_total",), 3)


def test_a_build_that_fails_is_counted_as_failed(empty, monkeypatch):
    upload(empty, "monday", recording(scans=6))
    monkeypatch.setattr(type(empty.service.runner), "_start", staticmethod(refuse_to_start))
    job = empty.post("/v1/maps/campus/builds", json={"segments": 1}).json()["job"]
    assert wait_for(empty, job)["state"] == "failed"
    assert settled(empty, ("tensormap_builds_total", "failed"), 1)


def test_a_catalog_that_is_gone_does_not_hide_the_metrics(own, monkeypatch):
    def gone(*_):
        raise StorageUnavailable("the catalog cannot be used")

    assert metrics_of(own)["tensormap_catalog_up",] == 1
    with monkeypatch.context() as patched:
        patched.setattr(own.service.store.jobs, "counts", gone)
        assert metrics_of(own)["tensormap_catalog_up",] == 0
    assert metrics_of(own)["tensormap_catalog_up",] == 1


def test_a_data_directory_that_is_gone_does_not_hide_the_metrics(own):
    data_dir = own.service.store.layout.data_dir
    assert metrics_of(own)["tensormap_disk_free_bytes",] > 0
    data_dir.rename(data_dir.with_name("gone"))
    try:
        assert math.isnan(metrics_of(own)["tensormap_disk_free_bytes",])
    finally:
        data_dir.with_name("gone").rename(data_dir)
    assert metrics_of(own)["tensormap_disk_free_bytes",] > 0


def test_of_two_disks_the_one_with_less_space_is_shown(own, monkeypatch):
    """`maps/` may be a link to a folder of another disk, which fills up first."""
    layout, usage = own.service.store.layout, shutil.disk_usage
    for full in (layout.maps, layout.data_dir):
        with monkeypatch.context() as patched:
            patched.setattr(
                shutil,
                "disk_usage",
                lambda path, full=full: usage(path)._replace(free=7 if path == full else 2**40),
            )
            assert metrics_of(own)["tensormap_disk_free_bytes",] == 7


def test_what_an_alert_waits_for_is_counted_from_0_on(own):
    """A series that begins with 1 has not risen, for Prometheus."""
    found = metrics_of(own)
    for state in ("done", "failed", "cancelled"):
        assert found["tensormap_builds_total", state] == 0
    for result in ("good", "damaged", "missing", "unreadable"):
        assert ("tensormap_scrub_files_total", result) in found
    for query in ("image", "scan", "signature", "track"):
        for outcome in ("localized", "ambiguous", "unknown_place"):
            assert found["tensormap_localizations_total", *sorted([query, outcome])] == 0


def test_the_5xx_of_every_route_are_counted_from_0_on(own):
    found = metrics_of(own)
    documented = [
        ("tensormap_http_requests_total", *sorted([path, method.upper(), status]))
        for path, operations in own.documented["paths"].items()
        for method, operation in operations.items()
        for status in operation["responses"]
        if status >= "500"
    ]
    assert len(documented) > 100
    assert [found.get(key) for key in documented] == [0] * len(documented)
    # While the catalog cannot be read a request is refused before its route is found.
    for method in ("DELETE", "GET", "PATCH", "POST", "PUT"):
        assert found["tensormap_http_requests_total", "(none)", "503", method] == 0


def test_a_fault_of_ours_is_counted_and_has_an_id(own, monkeypatch):
    def fall_over(*_, **__):
        raise ZeroDivisionError("not foreseen")

    monkeypatch.setattr(own.service.store.maps, "list", fall_over)
    failed = own.get("/v1/maps", headers={"X-Request-Id": "truck-7"})
    assert problem_of(failed) == (500, "internal-error")
    assert failed.json()["request_id"] == failed.headers["X-Request-Id"] == "truck-7"
    assert "not foreseen" not in failed.text
    assert metrics_of(own)["tensormap_http_requests_total", "/v1/maps", "500", "GET"] == 1


def refuse_to_start(_worker):
    raise OSError("no process")


def settled(client, key, value):
    """Return the metrics once one has a value: a build is counted after its job is done."""
    for _ in range(500):
        found = metrics_of(client)
        if found.get(key) == value:
            return found
        client.get("/livez")
    pytest.fail(f"{key} is {found.get(key)}, expected {value}")
