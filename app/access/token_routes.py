"""Tokens: a key is exchanged for one, to be given to what should not hold the key itself."""

from collections.abc import Set as AbstractSet
from datetime import UTC, datetime, timedelta

from fastapi import Response, status

from app.access.caller import Caller
from app.access.dependency import Asking
from app.access.scopes import ANY_SCOPE, Scope, needs
from app.access.secrets import TOKEN_PREFIX, new_secret, secret_hash
from app.access.token_schemas import TokenIn, TokenMade
from app.access.trail import note
from app.http import errors
from app.http.bodies.bodies import Json
from app.http.pooled_route import pooled_router
from app.http.problems import problems
from app.service import Running
from core.errors import InvalidParameters
from storage.errors import InvalidSlug
from storage.names import checked_slug

router = pooled_router(tags=["access"])


@router.post(
    "/tokens",
    dependencies=[needs(*ANY_SCOPE)],
    status_code=status.HTTP_201_CREATED,
    responses=problems(InvalidParameters, InvalidSlug, *errors.JSON_BODY, *errors.WRITING),
)
def exchange_token(
    wanted: Json[TokenIn], running: Running, asking: Asking, response: Response
) -> TokenMade:
    """Exchange the key of this request for a token, with no more rights and for an hour at most.

    It ends with the key. It never administers, and is itself exchanged for nothing.
    """
    if asking.key_hash is None:
        raise errors.KeyNeeded(
            "a key is exchanged for a token, and none came: this service has no keys"
        )
    if asking.by_token:
        raise errors.ScopeMissing("a key is exchanged for a token, a token is not")
    scopes, maps = _scopes(wanted, asking), _maps(wanted, asking)
    made = new_secret(TOKEN_PREFIX)
    note(f"token {made.id}: {', '.join(sorted(scopes))} for {wanted.expires_in_s} s")
    record = running.store.tokens.add(
        made.id,
        secret_hash(made.text),
        asking.key_hash,
        scopes,
        maps,
        datetime.now(UTC) + timedelta(seconds=wanted.expires_in_s),
    )
    response.headers["Cache-Control"] = "no-store"
    return TokenMade.of(record, token=record.id, key=asking.key_id, secret=made.text)


def _scopes(wanted: TokenIn, asking: Caller) -> AbstractSet[Scope]:
    given = {scope for scope in Scope if scope is not Scope.ADMIN and asking.may(scope)}
    if wanted.scopes is None:
        return given
    if Scope.ADMIN in wanted.scopes:
        raise InvalidParameters("a token never has scope admin: use the key itself")
    asking.require_all(wanted.scopes)
    return wanted.scopes


def _maps(wanted: TokenIn, asking: Caller) -> AbstractSet[str] | None:
    if wanted.maps is None:
        return asking.maps
    for slug in sorted(wanted.maps):
        if not asking.sees(checked_slug(slug)):
            raise errors.ScopeMissing(f"key {asking.key_id} is not for map {slug!r}")
    return wanted.maps
