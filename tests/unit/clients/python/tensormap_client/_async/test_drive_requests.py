"""Requests for one drive: what an answer says of a scan, and what it does not."""

import httpx2
import pytest
from tensormap_client import Rejected, ScanBody
from tensormap_client._sync.drive_requests import DriveRequests
from tensormap_client._sync.transport import Transport
from tensormap_client.uploaded import Put, Unusable

SCAN = ScanBody(3, b"returns", "application/vnd.tensormap.kitti")


def requests_of(answer: httpx2.Response) -> DriveRequests:
    connections = httpx2.MockTransport(lambda _: answer)
    transport = Transport(
        "http://maps.example", timeout_s=1.0, patience_s=0.0, connections=connections
    )
    return DriveRequests(transport, "campus", "monday")


def test_a_scan_that_the_service_refuses_is_skipped() -> None:
    problem = {"type": "/problems/scan-too-large", "detail": "it has too many returns"}
    put = requests_of(httpx2.Response(413, json=problem)).put_scan(SCAN)
    assert put == Put(0, (Unusable("3", "scan-too-large", "it has too many returns"),))


@pytest.mark.parametrize("status", [409, 413, 415, 422])
def test_a_refusal_by_a_proxy_is_none_of_a_scan_and_ends_the_upload(status) -> None:
    page = "<html><h1>Request Entity Too Large</h1></html>"
    with pytest.raises(Rejected, match=f"scans/3: {status} <html><h1>Request Entity Too Large"):
        requests_of(httpx2.Response(status, text=page)).put_scan(SCAN)
