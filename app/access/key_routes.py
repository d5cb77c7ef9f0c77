"""Keys: who may ask for what, given out and revoked by an administrator."""

from datetime import UTC, datetime
from typing import Annotated

from fastapi import Path, Response, status

from app.access.key_schemas import KeyIn, KeyMade, KeyOut
from app.access.scopes import Scope, needs
from app.access.secrets import new_secret, secret_hash
from app.access.trail import note
from app.http import errors
from app.http.bodies.bodies import Json
from app.http.pages import After, Limit, PageOut, page_out
from app.http.pooled_route import pooled_router
from app.http.problems import problems
from app.service import Running
from core.errors import InvalidParameters
from storage.errors import InvalidSlug, KeyNotFound
from storage.names import checked_slug

router = pooled_router(prefix="/keys", tags=["access"])

KeyId = Annotated[str, Path(alias="key", description="The key's id.")]


@router.post(
    "",
    dependencies=[needs(Scope.ADMIN)],
    status_code=status.HTTP_201_CREATED,
    responses=problems(InvalidParameters, InvalidSlug, *errors.JSON_BODY, *errors.WRITING),
)
def make_key(wanted: Json[KeyIn], running: Running, response: Response) -> KeyMade:
    """Make a key; its secret is in this answer and nowhere else.

    The first key of a service must be an administrator's: from then on keys are asked for.
    """
    _require_sense(wanted, is_first=running.access.is_open)
    made = new_secret()
    note(_in_short(made.id, wanted))
    record = running.store.keys.add(
        secret_hash(made.text),
        wanted.scopes,
        key_id=made.id,
        name=wanted.name,
        maps=wanted.maps,
        expires_at=wanted.expires_at,
    )
    response.headers["Location"] = f"/v1/keys/{record.id}"
    response.headers["Cache-Control"] = "no-store"
    return KeyMade(**KeyOut.from_record(record).model_dump(), secret=made.text)


@router.get(
    "",
    dependencies=[needs(Scope.ADMIN)],
    responses=problems(InvalidParameters, errors.InvalidRequest, *errors.READING),
)
def list_keys(running: Running, after: After = "", limit: Limit = 100) -> PageOut[KeyOut]:
    """List the keys in the order of their making, the revoked ones too."""
    page = running.store.keys.list(after, limit)
    return page_out(page, KeyOut.from_record)


@router.get(
    "/{key}", dependencies=[needs(Scope.ADMIN)], responses=problems(KeyNotFound, *errors.READING)
)
def get_key(key_id: KeyId, running: Running) -> KeyOut:
    """Show a key."""
    return KeyOut.from_record(running.store.keys.get(key_id))


@router.delete(
    "/{key}", dependencies=[needs(Scope.ADMIN)], responses=problems(KeyNotFound, *errors.WRITING)
)
def revoke_key(key_id: KeyId, running: Running) -> KeyOut:
    """Revoke a key at once and for good: the next request with it is refused.

    It stays in the list, for the audit. Whoever revokes the last administrator's key starts the
    service with `TENSORMAP_ADMIN_KEY` to make another.
    """
    return KeyOut.from_record(running.store.keys.revoke(key_id))


def _in_short(key_id: str, wanted: KeyIn) -> str:
    maps = "all maps" if wanted.maps is None else f"maps {', '.join(sorted(wanted.maps))}"
    end = "" if wanted.expires_at is None else f" until {wanted.expires_at.isoformat()}"
    return f"key {key_id}: {', '.join(sorted(wanted.scopes))} of {maps}{end}"


def _require_sense(wanted: KeyIn, *, is_first: bool) -> None:
    """Refuse a key that could open nothing, or more than it says."""
    is_admin = Scope.ADMIN in wanted.scopes
    if is_admin and wanted.maps is not None:
        raise InvalidParameters(
            "scope admin is limited to no maps: its holder could make a key without limits"
        )
    for slug in wanted.maps or ():
        checked_slug(slug)
    if wanted.expires_at is not None and wanted.expires_at <= datetime.now(UTC):
        raise InvalidParameters(f"expires_at is {wanted.expires_at.isoformat()}, wanted the future")
    if is_first and not (is_admin and wanted.expires_at is None):
        raise InvalidParameters(
            "the first key must have scope admin and no end: from then on keys are asked for, and"
            " nobody could make another"
        )
