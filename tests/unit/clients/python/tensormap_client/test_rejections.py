import json
import pickle

import pytest
from tensormap_client import Rejected, Unreachable, UnreachableByProxy
from tensormap_client.problems import PROBLEMS, MapNotFound, TooFewReturns
from tensormap_client.rejections import rejection

from app.http.errors import STATUS
from app.http.problems import problem_name


def test_the_classes_are_the_services_problems_and_lie_below_each_other_as_they_do():
    assert set(PROBLEMS) == {problem_name(kind) for kind in STATUS}
    for kind, status in STATUS.items():
        mine = PROBLEMS[problem_name(kind)]
        assert mine.usual_status == status
        for other in STATUS:
            assert issubclass(mine, PROBLEMS[problem_name(other)]) == issubclass(kind, other)
    assert TooFewReturns.__base__ is PROBLEMS["invalid-scan"]


def test_an_answer_becomes_the_error_of_its_problem():
    body = json.dumps({"type": "/problems/map-not-found", "detail": "there is no map 'a'"})
    error = rejection("GET /v1/maps/a", 404, body.encode())
    assert type(error) is MapNotFound
    assert str(error) == "GET /v1/maps/a: 404 map-not-found: there is no map 'a'"
    assert not error.is_passing


@pytest.mark.parametrize("body", [b"<html>bad gateway", b"[]", b"{}", b'{"type": "/problems/new"}'])
def test_an_answer_that_is_no_known_problem_is_a_plain_rejection(body):
    error = rejection("GET /", 408, body, {"Retry-After": "3"})
    assert type(error) is Rejected
    assert (error.status, error.problem, error.retry_after_s) == (408, "", 3.0)
    assert error.is_passing


@pytest.mark.parametrize("status", [502, 503, 504])
def test_a_service_for_which_a_proxy_answers_is_one_that_does_not_answer(status):
    error = rejection("GET /v1/maps", status, b"<html><h1>Bad Gateway</h1>", {"Retry-After": "3"})
    assert isinstance(error, Unreachable)
    assert isinstance(error, Rejected)
    assert error.is_passing
    assert str(error) == (
        f"GET /v1/maps: {status} a proxy answered for the service, which may still do what was"
        " asked: <html><h1>Bad Gateway</h1>"
    )
    copied = pickle.loads(pickle.dumps(error))
    assert (type(copied), copied.status, copied.retry_after_s) == (UnreachableByProxy, status, 3.0)


def test_a_problem_of_a_newer_service_keeps_its_name():
    body = json.dumps({"type": "/problems/new-one", "detail": "what came"})
    error = rejection("GET /", 409, body)
    assert (type(error), error.problem, error.detail) == (Rejected, "new-one", "what came")


@pytest.mark.parametrize(
    ("retry_after", "wanted_s"),
    [
        ("7", 7.0),
        ("Sat, 28 Nov 2026 00:02:10 GMT", 130.0),
        ("Fri, 27 Nov 2026 23:59:00 GMT", 0.0),
        ("28 Nov 2026 00:02:10", 0.0),
        ("soon", 0.0),
        ("", 0.0),
    ],
)
def test_a_date_to_try_again_is_counted_from_that_of_the_answer(retry_after, wanted_s):
    headers = {"Retry-After": retry_after, "Date": "Sat, 28 Nov 2026 00:00:00 GMT"}
    assert rejection("GET /", 503, b"", headers).retry_after_s == wanted_s
    del headers["Date"]
    assert rejection("GET /", 503, b"", headers).retry_after_s == (7.0 if wanted_s == 7.0 else 0.0)
