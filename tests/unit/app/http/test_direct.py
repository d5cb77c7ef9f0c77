"""The parameters of a route without FastAPI's solver."""

import asyncio
from contextlib import AsyncExitStack
from typing import Annotated, Any

import pytest
from fastapi import Query, Request
from fastapi.dependencies.utils import get_dependant, request_params_to_args
from pydantic import BaseModel, Field

from app.http import direct
from app.http.direct import Solver, Unsolvable


class Plain(BaseModel):
    number: Annotated[int, Field(lt=100)] | None = None
    named: str = Field("x", alias="other_name")


class WithList(BaseModel):
    numbers: list[int] = []


class Strict(BaseModel, extra="forbid"):
    number: int | None = None


def dependant_of(model: type[BaseModel]) -> Any:
    def route(query: Any) -> None: ...

    route.__annotations__["query"] = Annotated[model, Query()]
    return get_dependant(path="/", call=route)


def solved(solver: Solver, query: str) -> dict[str, Any]:
    request = Request({"type": "http", "query_string": query.encode(), "headers": []})
    return asyncio.run(solver.solve(request, AsyncExitStack()))


def by_fastapi(dependant: Any, query: str) -> dict[str, Any]:
    request = Request({"type": "http", "query_string": query.encode(), "headers": []})
    values, errors = request_params_to_args(dependant.query_params, request.query_params)
    assert not errors
    return values


@pytest.mark.parametrize(
    "query",
    ["", "number=7", "number=7&other_name=y", "other_name=", "named=y", "number=7&number=8", "z=1"],
)
def test_a_query_of_plain_fields_is_read_as_fastapi_reads_it_without_its_walk_over_the_fields(
    query, monkeypatch
):
    dependant = dependant_of(Plain)
    expected, solver = by_fastapi(dependant, query), Solver(dependant)
    monkeypatch.delattr(direct, "request_params_to_args")
    assert solved(solver, query) == expected


@pytest.mark.parametrize("query", ["number=x", "number=100", "number="])
def test_an_invalid_query_is_left_to_fastapi(query):
    with pytest.raises(Unsolvable):
        solved(Solver(dependant_of(Plain)), query)


@pytest.mark.parametrize(
    ("model", "query"),
    [(WithList, "numbers=1&numbers=2"), (WithList, "numbers=1"), (Strict, "number=1")],
)
def test_a_query_of_other_fields_is_read_by_fastapi(model, query):
    dependant = dependant_of(model)
    assert solved(Solver(dependant), query) == by_fastapi(dependant, query)
