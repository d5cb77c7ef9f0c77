"""Errors of parameters and JSON say what was wanted and what was received, in the API's words."""

from typing import Annotated, Literal

import pytest
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ConfigDict, Field, model_validator

from app.http.bodies.json_body import read_json
from app.http.exact_types import Flag, Lines, Number
from app.http.field_problems import field_problems


class InnerIn(BaseModel):
    model_config = ConfigDict(extra="forbid")

    x_m: Number = 0.0


class OuterIn(BaseModel):
    model_config = ConfigDict(extra="forbid")

    name: str = Field("", max_length=100)
    count: Annotated[int, Field(ge=1)] | Literal["all"] = 1
    flag: Flag = False
    whole: int = 0
    inner: InnerIn = InnerIn()
    items: list[InnerIn] = Field([], max_length=2)
    text: Lines | None = Field(None, max_length=3)

    @model_validator(mode="after")
    def _of_both(self):
        if self.name == "all" and self.flag:
            raise ValueError("give name or flag, not both")
        return self


def problems_of(body: bytes, model=OuterIn):
    with pytest.raises(RequestValidationError) as refused:
        read_json(body, model)
    return [(problem["where"], problem["what"]) for problem in field_problems(refused.value)]


@pytest.mark.parametrize(
    ("body", "where", "what"),
    [
        (b"[]", "body", "should be an object, got a list"),
        (b'{"inner": 3}', "body/inner", "should be an object, got 3"),
        (b'{"inner": {"x_m": "3"}}', "body/inner/x_m", "should be a valid number, got '3'"),
        (b'{"items": {}}', "body/items", "should be a valid list, got an object"),
        (b'{"items": [{}, null]}', "body/items/1", "should be an object, got null"),
        (b'{"items": [{}, {}, {}]}', "body/items", "should have at most 2 items, not 3"),
        (b'{"text": "four"}', "body/text", "should have at most 3 characters, not 4, got 'four'"),
        (b'{"flag": "yes"}', "body/flag", "should be true or false, got 'yes'"),
        (b'{"name": 5}', "body/name", "should be a valid string, got 5"),
        (b'{"whole": 1.5}', "body/whole", "should be a valid integer, got 1.5"),
        (
            b'{"nme": "x"}',
            "body/nme",
            "is no field of this object, it has count, flag, inner, items, name, text, whole",
        ),
        (b'{"inner": {"y": 1}}', "body/inner/y", "is no field of this object, it has x_m"),
        (b'{"items": [{"y": 1}]}', "body/items/0/y", "is no field of this object, it has x_m"),
        (b'{"name": "all", "flag": true}', "body", "give name or flag, not both"),
    ],
)
def test_a_problem_says_what_was_wanted_and_what_came(body, where, what):
    assert problems_of(body) == [(where, what)]


def test_a_field_that_takes_true_only_is_worded_in_json():
    class ClosingIn(BaseModel):
        closed: Literal[True]

    assert problems_of(b'{"closed": false}', ClosingIn) == [
        ("body/closed", "should be true, got false")
    ]


def test_the_place_is_a_path_through_the_body_without_names_of_types():
    assert problems_of(b'{"count": 0}') == [
        ("body/count", "should be greater than or equal to 1, got 0"),
        ("body/count", "should be 'all', got 0"),
    ]


class NamedIn(BaseModel):
    name: str


class ManyIn(BaseModel):
    items: list[NamedIn]


def test_a_missing_field_is_named_without_the_others():
    assert problems_of(b'{"items": [{"secret": 1}]}', ManyIn) == [
        ("body/items/0/name", "is missing")
    ]


def test_what_came_is_shortened():
    [(_, what)] = problems_of(b'{"name": "%s"}' % (b"x" * 4_000))
    assert what.startswith("should have at most 100 characters, got 'xxx")
    assert what.endswith("x...'")
    assert len(what) < 150


def test_a_key_that_came_by_mistake_is_not_shown():
    [(_, what)] = problems_of(b'{"flag": "tm_0123456789abcdef_AbCdEfGhIjKl"}')
    assert what == "should be true or false, got 'tm_(hidden)'"
    [(where, _)] = problems_of(b'{"tm_0123456789abcdef_AbCdEfGhIjKl": 1}')
    assert where == "body/tm_(hidden)"


def test_json_that_cannot_be_parsed_is_said_to_be_none_with_its_place():
    [(where, what)] = problems_of(b'{"name": }')
    assert (where, what) == ("body", "is no JSON: Expecting value at character 9")


def test_a_key_that_comes_twice_in_one_object_is_named():
    body = b'{"inner": {"x_m": 1.0, "x_m": 2.0}, "name": "a", "other": {"x_m": 1.0}}'
    assert problems_of(body) == [("body/x_m", "came 2 times in one object, wanted once")]


def test_half_of_a_surrogate_pair_can_be_sent_back():
    for body in (b'{"\\ud800": 1}', b'{"flag": "\\ud800"}'):
        [(where, what)] = problems_of(body)
        assert (where + what).encode()
