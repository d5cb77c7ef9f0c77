"""Requests are repeated where that helps, and nowhere else."""

import httpx2
import pytest

from app.upload_client.errors import Rejected, Unreachable, UploadFailed
from app.upload_client.transport import Transport


class Service:
    """Answers with each of some answers in turn; raises those that are errors."""

    def __init__(self, *answers: httpx2.Response | Exception) -> None:
        self.answers = list(answers)
        self.requests: list[httpx2.Request] = []
        self.waited_s: list[float] = []

    def __call__(self, request: httpx2.Request) -> httpx2.Response:
        self.requests.append(request)
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def transport(self, **options) -> Transport:
        return Transport(
            "http://maps.example/under",
            "the-key",
            wait=self.waited_s.append,
            connections=httpx2.MockTransport(self),
            **options,
        )


def problem(status: int, name: str, detail: str) -> httpx2.Response:
    return httpx2.Response(status, json={"type": f"/problems/{name}", "detail": detail})


LOST = httpx2.ReadError("connection reset")
OK = httpx2.Response(200, json={})


def test_a_request_has_the_key_and_lies_below_the_url() -> None:
    service = Service(OK)
    service.transport().request("GET", "/v1/maps")
    [request] = service.requests
    assert str(request.url) == "http://maps.example/under/v1/maps"
    assert request.headers["Authorization"] == "Bearer the-key"


def test_after_a_lost_connection_or_a_busy_answer_the_same_request_is_sent_again() -> None:
    busy = problem(503, "service-busy", "later")
    limited = httpx2.Response(429, headers={"Retry-After": "7"}, json={})
    service = Service(OK, LOST, busy, limited, OK)
    transport = service.transport()
    transport.request("GET", "/v1/maps")
    transport.request("PUT", "/v1/scan", content=b"returns")
    assert [request.content for request in service.requests[1:]] == [b"returns"] * 4
    assert service.waited_s == [0.25, 0.5, 7.0]


def test_a_service_that_never_answered_is_reported_at_once() -> None:
    service = Service(httpx2.ConnectError("refused"))
    with pytest.raises(Unreachable, match=r"/under cannot be reached: refused"):
        service.transport().request("GET", "/v1/maps")
    assert not service.waited_s


def test_patience_has_an_end() -> None:
    service = Service(OK, *[LOST] * 9)
    transport = service.transport(patience_s=0.2)
    transport.request("GET", "/v1/maps")
    with pytest.raises(Unreachable, match="connection reset"):
        transport.request("GET", "/v1/maps")


def test_a_rejection_is_an_error_with_the_problem_and_is_not_repeated() -> None:
    service = Service(problem(404, "map-not-found", "there is no map 'campus'"))
    with pytest.raises(Rejected, match="404 map-not-found: there is no map 'campus'") as caught:
        service.transport().request("GET", "/v1/maps/campus")
    assert (caught.value.status, caught.value.problem) == (404, "map-not-found")
    assert len(service.requests) == 1


def test_an_answer_of_something_else_is_an_error_with_its_text() -> None:
    service = Service(httpx2.Response(404, text="<html>no such site</html>"))
    with pytest.raises(Rejected, match="404 <html>no such site"):
        service.transport().request("GET", "/v1/maps/campus")


@pytest.mark.parametrize("url", ["127.0.0.1:8000", "maps.example", "ftp://maps.example", "http:"])
def test_what_is_no_url_is_rejected(url) -> None:
    with pytest.raises(UploadFailed, match="is no URL of a service"):
        Transport(url)
