"""Requests are repeated where that helps, and nowhere else."""

import httpx2
import pytest
from tensormap_client import (
    Admin,
    Rejected,
    Unreachable,
    UnreachableByProxy,
)
from tensormap_client._sync import transport as module
from tensormap_client._sync.transport import Transport

from tests.support.client_transport import LOST, OK, Clock, Service, problem, replace_clock


@pytest.fixture(autouse=True)
def clock(monkeypatch) -> Clock:
    return replace_clock(monkeypatch)


@pytest.fixture
def waited_s(clock) -> list[float]:
    """What the transport waited."""
    waited: list[float] = clock.waited_s
    return waited


def test_after_a_lost_connection_or_a_busy_answer_the_same_request_is_sent_again(waited_s) -> None:
    busy = problem(503, "service-busy", "later")
    limited = httpx2.Response(429, headers={"Retry-After": "7"}, json={})
    service = Service(OK, LOST, busy, limited, OK)
    transport = service.transport()
    transport.request("GET", "/v1/maps")
    transport.request("PUT", "/v1/scan", content=b"returns")
    assert [request.content for request in service.requests[1:]] == [b"returns"] * 4
    assert waited_s == [0.25, 0.5, 1.5 * 7.0]


def test_a_service_that_never_answered_is_reported_at_once(waited_s) -> None:
    service = Service(httpx2.ConnectError("refused"))
    with pytest.raises(Unreachable, match=r"/under cannot be reached: refused"):
        service.transport().request("GET", "/v1/maps")
    assert not waited_s


def test_a_timeout_without_a_text_is_named(waited_s) -> None:
    service = Service(httpx2.ReadTimeout(""))  # as with asyncio
    with pytest.raises(Unreachable, match=r"cannot be reached: ReadTimeout\(''\)$"):
        service.transport().request("GET", "/v1/maps")


@pytest.mark.parametrize(
    ("patience_s", "attempts_s"),
    [
        (0.0, [0.0]),
        (0.2, [0.0, 0.2]),
        (10.0, [0.0, 0.25, 0.75, 1.75, 3.75, 7.75, 10.0]),
        (15.0, [0.0, 0.25, 0.75, 1.75, 3.75, 7.75, 15.0]),
    ],
)
def test_the_last_attempt_is_at_the_end_of_the_patience(clock, patience_s, attempts_s) -> None:
    attempted_s: list[float] = []

    def away(_: httpx2.Request) -> httpx2.Response:
        attempted_s.append(clock.now_s)
        return problem(503, "service-busy", "later")

    transport = Transport(
        "http://maps.example",
        timeout_s=2.0,
        patience_s=patience_s,
        connections=httpx2.MockTransport(away),
    )
    with pytest.raises(Rejected, match="later"):
        transport.request("GET", "/v1/maps")
    assert attempted_s == attempts_s


def test_attempts_of_clients_that_lost_the_service_together_are_apart(clock, monkeypatch) -> None:
    monkeypatch.undo()  # of `random`
    monkeypatch.setattr(module, "sleep", clock.sleep)
    for _ in range(20):
        transport = Service(problem(503, "service-busy", "later"), OK).transport()
        transport.request("GET", "/v1/maps")
    assert len(set(clock.waited_s)) > 10
    assert 0.125 <= min(clock.waited_s) <= max(clock.waited_s) <= 0.25


def test_a_wait_that_a_proxy_asks_for_is_cut_and_ends_with_the_patience(waited_s) -> None:
    page = httpx2.Response(503, html="<html>maintenance</html>", headers={"Retry-After": "3600"})
    with pytest.raises(UnreachableByProxy):
        Service(*[page] * 2).transport(patience_s=10.0).request("GET", "/v1/maps")
    assert waited_s == [10.0]
    Service(page, page, OK).transport(patience_s=300.0).request("GET", "/v1/maps")
    assert waited_s[1:] == [30.0, 30.0]


def test_a_wait_of_the_services_own_beyond_the_patience_ends_it_at_once(waited_s) -> None:
    limited = problem(429, "too-many-requests", "no more bytes today")
    limited.headers["Retry-After"] = "3600"
    with pytest.raises(Rejected, match="today") as caught:
        Service(limited).transport().request("GET", "/v1/maps")
    assert (waited_s, caught.value.retry_after_s) == ([], 3600.0)


@pytest.mark.parametrize(
    "act",
    [
        lambda admin: admin.make_key("van", ["localize"]),
        lambda admin: admin.exchange_token(),
        # A second deletion is 404, as if there had never been one.
        lambda admin: admin.delete_revision("campus", "1f"),
    ],
)
def test_what_would_be_another_act_is_not_sent_again_after_a_lost_connection(act) -> None:
    service = Service(httpx2.Response(200, json={"items": [], "next_after": None}), LOST)
    with Admin("http://maps.example", connections=httpx2.MockTransport(service)) as admin:
        assert list(admin.keys()) == []
        with pytest.raises(Unreachable, match="connection reset"):
            act(admin)
    assert len(service.requests) == 2


@pytest.mark.parametrize(
    "answer",
    [
        httpx2.Response(504, text="<html>Gateway Timeout</html>"),
        httpx2.Response(502, text="<html>Bad Gateway</html>"),
        httpx2.Response(408, text="<html>Request Timeout</html>"),
        problem(503, "service-busy", "the service stopped before the answer"),
        problem(503, "storage-unavailable", "the catalog's database fails"),
    ],
)
def test_what_would_be_another_act_is_not_sent_again_if_it_may_be_done(answer) -> None:
    service = Service(answer)
    with Admin("http://maps.example", connections=httpx2.MockTransport(service)) as admin:
        with pytest.raises(Rejected) as caught:
            admin.make_key("van", ["localize"])
        assert caught.value.status == answer.status_code
    assert len(service.requests) == 1


def test_what_would_be_another_act_is_sent_again_if_it_was_never_begun() -> None:
    limited = problem(429, "too-many-requests", "wait 1 s")
    full = problem(503, "too-many-connections", "the limit of connections is reached")
    service = Service(limited, full, httpx2.Response(201, json={"key": "k1"}))
    with Admin("http://maps.example", connections=httpx2.MockTransport(service)) as admin:
        assert admin.make_key("van", ["localize"]) == {"key": "k1"}
    assert len(service.requests) == 3
