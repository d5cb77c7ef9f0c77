"""Whose `X-Forwarded-For` is believed: of the proxies that the operator names, nobody else."""

import httpx2
import pytest

from tests.e2e.test_operation import started
from tests.support.process import NO_TLS
from tests.support.service import problem_of

LIMITED = {
    "TENSORMAP_ADMIN_KEY": "correct horse battery staple",
    "TENSORMAP_REQUESTS_PER_S": "0.001",
}


@pytest.fixture
def service(tmp_path, tensormap):
    """Starts `tensormap serve` with settings; returns a client of it, and ends it."""
    processes = []

    def start(**variables):
        port, process = started(tmp_path / "data", tmp_path / "log", tensormap.program, **variables)
        processes.append(process)
        return f"http://127.0.0.1:{port}"

    yield start
    for process in processes:
        process.terminate()
        process.wait(30)


def answers(url, addresses):
    """Ask without a key, each time in the name of another address."""
    with httpx2.Client(base_url=url, verify=NO_TLS, timeout=60) as client:
        return [
            problem_of(client.get("/v1/maps", headers={"X-Forwarded-For": address}))[0]
            for address in addresses
        ]


ADDRESSES = [f"192.0.2.{number}" for number in range(4)]


def test_a_client_on_this_machine_cannot_take_another_address(service, tmp_path):
    url = service(**LIMITED, TENSORMAP_REQUEST_BURST="2")
    assert answers(url, ADDRESSES) == [401, 401, 429, 429]
    assert "192.0.2." not in (tmp_path / "log").read_text()


def test_a_proxy_that_is_trusted_tells_each_clients_address(service, tmp_path):
    url = service(**LIMITED, TENSORMAP_REQUEST_BURST="2", TENSORMAP_TRUSTED_PROXIES="127.0.0.1")
    assert answers(url, ADDRESSES) == [401, 401, 401, 401]
    assert answers(url, ADDRESSES[:1] * 2) == [401, 429]
    # What a client says of itself stands before what the proxy adds.
    assert answers(url, [f"198.51.100.7, {ADDRESSES[0]}"]) == [429]
    assert '"client": "192.0.2.3"' in (tmp_path / "log").read_text()
