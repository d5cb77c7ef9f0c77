"""The description of the fields of answers' heads."""

from app.http.answer_headers import ETAG, LEAST_CELLS, LOCATION, describe_heads, headed


def _required(answer: dict[str, dict[str, dict[str, bool]]]) -> dict[str, bool]:
    return {name: field["required"] for name, field in answer["headers"].items()}


def test_a_route_describes_the_fields_that_its_answers_have_always_and_sometimes() -> None:
    found = headed(ETAG, sometimes=(LEAST_CELLS,))
    assert _required(found) == {"ETag": True, "TensorMap-Least-Cells": False}
    assert all(field["description"] for field in found["headers"].values())


def test_each_answer_is_described_with_the_fields_of_its_status_and_with_its_own() -> None:
    answers = {"201": headed(LOCATION), "401": {}, "429": {}}
    describe_heads({"security": [{}], "responses": answers})
    of_all = {"X-Request-Id": True, "RateLimit": False, "RateLimit-Policy": False}
    assert {status: _required(answer) for status, answer in answers.items()} == {
        "201": {"Location": True, **of_all},
        "401": {"WWW-Authenticate": True, **of_all},
        "429": {"Retry-After": False, **of_all},
    }


def test_a_route_without_keys_has_no_limits_of_keys() -> None:
    answers = {"200": headed()}
    describe_heads({"responses": answers})
    assert _required(answers["200"]) == {"X-Request-Id": True}
