"""Shared bases: made of maps, and used by builds of any map."""

from typing import Annotated, Any

from fastapi import Path, Response, status

from app.access.api_router import api_router
from app.access.caller import Caller
from app.access.dependency import CurrentCaller
from app.access.scopes import Scope, needs
from app.access.trail import note
from app.bases.making import basis_of_maps
from app.bases.schemas import SharedBasisIn, SharedBasisOut
from app.http import errors
from app.http.answer_headers import LOCATION, headed
from app.http.bodies.bodies import Json
from app.http.pages import After, Limit, PageOut, page_out
from app.http.pooled_route import heavy
from app.http.problems import problems
from app.revisions.basis_answers import (
    BASIS_ANSWERS,
    Accept,
    IfNoneMatch,
    basis_answer,
    basis_tag,
)
from app.revisions.schemas import BasisOut
from app.service import Running
from core.errors import InvalidParameters
from storage import errors as stored

reading = api_router(tags=["shared bases"], dependencies=(needs(Scope.MAPS_READ, Scope.LOCALIZE),))
writing = api_router(tags=["shared bases"], dependencies=(needs(Scope.MAPS_WRITE),))

BasisName = Annotated[
    str,
    Path(
        alias="basis",
        max_length=64,
        description="The basis's name, its digest or at least the first 12 digits of that.",
        examples=["city"],
    ),
]


@writing.post(
    "/bases",
    status_code=status.HTTP_201_CREATED,
    responses={
        201: headed(LOCATION),
        200: {
            "model": SharedBasisOut,
            "description": "It is stored under this name already.",
            **headed(LOCATION),
        },
        **problems(
            stored.InvalidSlug,
            stored.BasisExists,
            stored.MapNotFound,
            stored.NoLiveRevision,
            stored.RevisionNotFound,
            stored.DriveNotFound,
            stored.CorruptFile,
            stored.CorruptImages,
            InvalidParameters,
            *errors.JSON_BODY,
            *errors.WRITING,
        ),
    },
)
@heavy
def share_basis(
    sent: Json[SharedBasisIn], running: Running, response: Response, caller: CurrentCaller
) -> SharedBasisOut:
    """Store a basis that builds of any map can use, with `basis`.

    It belongs to no map: the key must not be limited to some.
    """
    note(f"basis {sent.name}")
    _require_all_maps(caller)
    record, added = running.store.bases.add(sent.name, basis_of_maps(running.store, sent.maps))
    if not added:
        response.status_code = status.HTTP_200_OK
    response.headers[LOCATION] = f"/v1/bases/{record.name}"
    return SharedBasisOut.from_record(record)


@reading.get("/bases", responses=problems(errors.InvalidRequest, *errors.READING))
def list_bases(running: Running, after: After = "", limit: Limit = 100) -> PageOut[SharedBasisOut]:
    """List the shared bases by name."""
    return page_out(running.store.bases.list(after, limit), SharedBasisOut.from_record)


@reading.get(
    "/bases/{basis}",
    response_model=BasisOut,
    responses={
        **BASIS_ANSWERS,
        **problems(
            stored.BasisNotFound, stored.CorruptFile, errors.InvalidRequest, *errors.READING
        ),
    },
)
def get_shared_basis(
    basis: BasisName, running: Running, accept: Accept = "", if_none_match: IfNoneMatch = None
) -> Any:  # noqa: ANN401 - JSON by its model, or bytes as they are
    """Download a shared basis to make signatures with, as JSON or, on `Accept`, as NumPy's npz.

    It names no revision and has no `least_cells`, which a map has. Its ETag is that of the basis of
    every revision that has it with the same `parameters`.
    """
    shared = running.store.bases.read(basis)
    tag = basis_tag(shared.digest, shared.parameters)
    return basis_answer(lambda: shared, accept, if_none_match, tag=tag)


@writing.delete(
    "/bases/{basis}",
    status_code=status.HTTP_204_NO_CONTENT,
    responses=problems(
        stored.BasisNotFound, stored.BasisInUse, errors.InvalidRequest, *errors.WRITING
    ),
)
def delete_basis(basis: BasisName, running: Running, caller: CurrentCaller) -> None:
    """Remove a shared basis that no revision has and no build uses."""
    _require_all_maps(caller)
    running.store.bases.delete(basis)


def _require_all_maps(caller: Caller) -> None:
    if caller.maps is not None:
        raise errors.ScopeMissing(
            f"key {caller.key_id} is limited to some maps; a shared basis belongs to none of them"
        )
