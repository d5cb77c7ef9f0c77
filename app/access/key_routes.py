"""Keys, made and revoked by an administrator, and tokens, for which a key is exchanged."""

from collections.abc import Set as AbstractSet
from datetime import UTC, datetime, timedelta
from typing import Annotated

from fastapi import Path, Response, status

from app.access.api_router import api_router
from app.access.caller import Caller
from app.access.dependency import CurrentCaller
from app.access.key_schemas import KeyIn, KeyMade, KeyOut, TokenIn, TokenMade
from app.access.scopes import SCOPES_OF_ALL_MAPS, SCOPES_OF_TOKENS, Scope, needs
from app.access.secrets import TOKEN_PREFIX, new_secret, secret_hash
from app.access.trail import note
from app.http import errors
from app.http.answer_headers import LOCATION, headed
from app.http.bodies.bodies import Json
from app.http.pages import After, Limit, PageOut, page_out
from app.http.problems import problems
from app.service import Running, Service
from core.errors import InvalidParameters
from storage.catalog import KeyRecord
from storage.errors import InvalidSlug, KeyNotFound, TooManyTokens
from storage.names import checked_slug

keys = api_router(tags=["access"], dependencies=(needs(Scope.ADMIN),))
tokens = api_router(tags=["access"], dependencies=(needs(*SCOPES_OF_TOKENS),))

KeyId = Annotated[str, Path(alias="key", description="The key's id.")]

_MAKING = (InvalidParameters, InvalidSlug, *errors.JSON_BODY, *errors.WRITING)


@keys.post(
    "/keys",
    status_code=status.HTTP_201_CREATED,
    responses={201: headed(LOCATION), **problems(*_MAKING)},
)
def make_key(sent: Json[KeyIn], running: Running, response: Response) -> KeyMade:
    """Make a key; its secret is in this answer and nowhere else.

    The first key of a service must be an administrator's: from then on every request needs a key.
    """
    _require_usable(sent, is_first=running.access.is_open)
    made = new_secret()
    note(_summary(made.id, sent))
    record = running.store.keys.add(
        secret_hash(made.text),
        sent.scopes,
        key_id=made.id,
        name=sent.name,
        maps=sent.maps,
        expires_at=sent.expires_at,
    )
    response.headers[LOCATION] = f"/v1/keys/{record.id}"
    response.headers["Cache-Control"] = "no-store"
    return KeyMade(**_shown(record, running).model_dump(), secret=made.text)


@keys.get("/keys", responses=problems(InvalidParameters, errors.InvalidRequest, *errors.READING))
def list_keys(running: Running, after: After = "", limit: Limit = 100) -> PageOut[KeyOut]:
    """List the keys in the order in which they were made, revoked ones too."""
    page = running.store.keys.list(after, limit)
    return page_out(page, lambda record: _shown(record, running))


@keys.get("/keys/{key}", responses=problems(KeyNotFound, *errors.READING))
def get_key(key_id: KeyId, running: Running) -> KeyOut:
    """Show a key."""
    return _shown(running.store.keys.get(key_id), running)


@keys.delete("/keys/{key}", responses=problems(KeyNotFound, *errors.WRITING))
def revoke_key(key_id: KeyId, running: Running) -> KeyOut:
    """Revoke a key at once and for good: the next request with it is rejected.

    It stays in the list, for the audit. After revoking the last administrator's key, start the
    service with `TENSORMAP_ADMIN_KEY` to make another.
    """
    return _shown(running.store.keys.revoke(key_id), running)


@tokens.post(
    "/tokens",
    status_code=status.HTTP_201_CREATED,
    responses=problems(TooManyTokens, *_MAKING),
)
def exchange_token(
    sent: Json[TokenIn], running: Running, caller: CurrentCaller, response: Response
) -> TokenMade:
    """Exchange the key of this request for a token, with no more rights and for an hour at most.

    It expires with the key. It never has scope `admin` or `metrics`, and cannot be exchanged
    itself. A key has a limited number of valid tokens.
    """
    if caller.key_hash is None:
        raise errors.KeyNeeded(
            "a key is exchanged for a token, and none was sent: this service has no keys"
        )
    if caller.by_token:
        raise errors.ScopeMissing("a key is exchanged for a token, a token is not")
    scopes, maps = _token_scopes(sent, caller), _token_maps(sent, caller)
    made = new_secret(TOKEN_PREFIX)
    note(f"token {made.id}: {', '.join(sorted(scopes))} for {sent.expires_in_s} s")
    record = running.store.tokens.add(
        made.id,
        secret_hash(made.text),
        caller.key_hash,
        scopes,
        maps,
        datetime.now(UTC) + timedelta(seconds=sent.expires_in_s),
        most=running.settings.max_tokens_per_key,
    )
    response.headers["Cache-Control"] = "no-store"
    return TokenMade.of(record, token=record.id, key=caller.key_id, secret=made.text)


def _summary(key_id: str, sent: KeyIn) -> str:
    maps = "all maps" if sent.maps is None else f"maps {', '.join(sorted(sent.maps))}"
    end = "" if sent.expires_at is None else f" until {sent.expires_at.isoformat()}"
    return f"key {key_id}: {', '.join(sorted(sent.scopes))} of {maps}{end}"


def _require_usable(sent: KeyIn, *, is_first: bool) -> None:
    """Reject a key that could be used for nothing, or for more than its limits."""
    of_all_maps = sorted(sent.scopes.intersection(SCOPES_OF_ALL_MAPS))
    if of_all_maps and sent.maps is not None:
        raise InvalidParameters(
            f"scope {of_all_maps[0]} is of all maps: make a key with it and without `maps`"
        )
    for slug in sent.maps or ():
        checked_slug(slug)
    if sent.expires_at is not None and sent.expires_at <= datetime.now(UTC):
        raise InvalidParameters(f"expires_at is {sent.expires_at.isoformat()}, wanted the future")
    if is_first and not (Scope.ADMIN in sent.scopes and sent.expires_at is None):
        raise InvalidParameters(
            "the first key must have scope admin and never expire: from then on every request needs"
            " a key, and nobody could make another"
        )


def _token_scopes(sent: TokenIn, caller: Caller) -> AbstractSet[Scope]:
    if sent.scopes is None:
        return {scope for scope in SCOPES_OF_TOKENS if caller.may(scope)}
    if never := sorted(sent.scopes.difference(SCOPES_OF_TOKENS)):
        raise InvalidParameters(f"a token never has scope {never[0]}: use the key itself")
    caller.require_all(sent.scopes)
    return sent.scopes


def _token_maps(sent: TokenIn, caller: Caller) -> AbstractSet[str] | None:
    if sent.maps is None:
        return caller.maps
    for slug in sorted(sent.maps):
        if not caller.sees(checked_slug(slug)):
            raise errors.ScopeMissing(f"key {caller.key_id} is not for map {slug!r}")
    return sent.maps


def _shown(record: KeyRecord, running: Service) -> KeyOut:
    in_use = running.access.refusal_of(record) is None
    return KeyOut.of(record, key=record.id, in_use=in_use)
