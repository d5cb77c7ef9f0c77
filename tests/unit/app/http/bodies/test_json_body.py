"""JSON bodies: what is wrong with one costs little to report."""

import json

import pytest
from fastapi.exceptions import RequestValidationError

from app.builds.parameters import BuildParameters
from app.drives.pose_schemas import PosesIn
from app.http.bodies.json_body import read_json
from app.http.errors import InvalidRequest
from app.http.field_problems import field_problems, with_names


def unknown(keys):
    return {f"k{number}": 1 for number in range(keys)}


@pytest.mark.parametrize("body", [unknown(1001), {"poses": [{"scan": 0, **unknown(1000)}]}])
def test_an_object_of_many_keys_is_rejected_before_each_is_an_error(body, monkeypatch):
    """49,000 unknown keys took 3 s of CPU, of which other threads waited half a second."""
    monkeypatch.setattr(PosesIn, "model_validate", lambda _: pytest.fail("it was validated"))
    with pytest.raises(InvalidRequest, match="an object has 1001 keys, at most 1000 are read"):
        read_json(json.dumps(body).encode(), PosesIn)


def test_an_object_may_have_as_many_keys_as_the_limit():
    with pytest.raises(RequestValidationError) as refused:
        read_json(json.dumps(unknown(1000)).encode(), BuildParameters)
    assert len(refused.value.errors()) == 1000


def test_of_a_thousand_faults_those_that_are_shown_are_worded(monkeypatch):
    worded = []

    def noted(fault, model):
        worded.append(fault["loc"])
        return with_names(fault, model)

    monkeypatch.setattr("app.http.bodies.json_body.with_names", noted)
    with pytest.raises(RequestValidationError) as refused:
        read_json(json.dumps(unknown(1000)).encode(), BuildParameters)
    shown = field_problems(refused.value)
    assert len(worded) == len(shown) == 20
    assert shown[19]["where"] == "body/k19"
    assert "it has " in shown[19]["what"]
    assert {fault["loc"][0] for fault in refused.value.errors()} == {"body"}
