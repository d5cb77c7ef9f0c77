"""`X-Forwarded-For` is trusted from the configured proxies only."""

import socket

import httpx2
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from tests.support.process import NO_TLS, serving
from tests.support.service import problem_of

LIMITED = {
    "admin_key": "correct horse battery staple",
    "requests_per_s": "0.001",
    "log_format": "json",
}


def answers(url, addresses):
    """Send requests without a key, each with another forwarded address."""
    with httpx2.Client(base_url=url, verify=NO_TLS, timeout=60) as client:
        return [
            problem_of(client.get("/v1/maps", headers={"X-Forwarded-For": address}))[0]
            for address in addresses
        ]


ADDRESSES = [f"192.0.2.{number}" for number in range(4)]


def test_a_client_on_this_machine_cannot_take_another_address(tmp_path):
    with serving(tmp_path / "data", tmp_path / "log", **LIMITED, request_burst="2") as server:
        assert answers(server.client.base_url, ADDRESSES) == [401, 401, 429, 429]
    assert "192.0.2." not in (tmp_path / "log").read_text()


def test_a_trusted_proxy_passes_on_each_clients_address(tmp_path):
    proxied = {"request_burst": "2", "trusted_proxies": "127.0.0.1"}
    with serving(tmp_path / "data", tmp_path / "log", **LIMITED, **proxied) as server:
        url = server.client.base_url
        assert answers(url, ADDRESSES) == [401, 401, 401, 401]
        assert answers(url, ADDRESSES[:1] * 2) == [401, 429]
        # The client's own value precedes the one that the proxy adds.
        assert answers(url, [f"198.51.100.7, {ADDRESSES[0]}"]) == [429]
    assert '"client": "192.0.2.3"' in (tmp_path / "log").read_text()


@pytest.mark.skipif(not socket.has_dualstack_ipv6(), reason="this machine has no IPv6")
def test_on_all_addresses_a_proxy_is_trusted_by_its_address_of_ipv4(tmp_path):
    """There the system shows 127.0.0.1 as ::ffff:127.0.0.1."""
    log = tmp_path / "log"
    proxied = {"request_burst": "2", "trusted_proxies": "127.0.0.1", "host": "::"}
    with serving(tmp_path / "data", log, **LIMITED, **proxied) as server:
        at = f"127.0.0.1:{server.client.base_url.port}"
        assert answers(f"http://{at}", ADDRESSES) == [401, 401, 401, 401]
        with pytest.raises(InvalidStatus):
            connect(
                f"ws://{at}/v1/maps/campus/tracks/t/stream",
                additional_headers={"X-Forwarded-For": "198.51.100.7"},
                proxy=None,
            )
        httpx2.get(f"http://{at}/livez")
    for client in ("192.0.2.3", "198.51.100.7", "127.0.0.1"):
        assert f'"client": "{client}"' in log.read_text()
    assert "::ffff:" not in log.read_text()
