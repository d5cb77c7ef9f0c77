"""The demonstration's own client: how it fails."""

import httpx2
import pytest

from app.demo.client import DemoClient
from app.demo.errors import DemoFailed


def test_a_service_that_ended_is_the_demonstrations_failure(monkeypatch) -> None:
    def refused(*_: object, **__: object) -> httpx2.Response:
        raise httpx2.ConnectError("[Errno 111] Connection refused")

    monkeypatch.setattr(httpx2.Client, "request", refused)
    with (
        DemoClient("http://127.0.0.1:9", "demo") as client,
        pytest.raises(DemoFailed, match=r"^POST /v1/maps/demo/localizations/scan: .* refused$"),
    ):
        client.localize("scan", b"body")
