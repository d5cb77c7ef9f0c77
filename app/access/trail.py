"""Entries of the audit log: every requested change and its outcome."""

import logging
from asyncio import CancelledError
from functools import partial
from http import HTTPStatus
from urllib.parse import quote

from anyio import to_thread
from fastapi import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from app.access.caller import Caller
from app.access.rate_limits import RateLimits
from app.access.scopes import Scope as KeyScope
from app.access.scopes import needed_by
from app.http.context import context_of
from app.http.errors import TooManyRequests
from app.http.redaction import without_keys
from core.errors import TensorMapError
from storage.catalog import Act, on_behalf
from storage.catalog.acts import current_act
from storage.errors import InvalidSlug, StorageFailure, with_cause
from storage.names import checked_slug
from storage.store import Store

_log = logging.getLogger("tensormap.audit")
_SAFE = frozenset({"GET", "HEAD", "OPTIONS"})
# Of each key: entries stay for good, and a key without any right could otherwise fill the disk.
_FAILURES_AT_ONCE = 100
_FAILURES_PER_S = 1 / 60


class AuditTrail:
    """Records every request that may change something as its caller's.

    A change is logged in the same commit, also one of a request that fails later, such as the scans
    that an interrupted upload has stored. That a request was rejected or failed is logged after its
    answer: if that fails, no change lacks its entry. Of those of one key, 100 at once and then one
    a minute are logged; the server's own log has all. Requests without a valid key are not logged
    here, or anybody could fill the disk; they are in the server's own log.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self._failures = RateLimits(_FAILURES_PER_S, _FAILURES_AT_ONCE)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""
        if scope["type"] != "http" or scope["method"] in _SAFE:
            await self._app(scope, receive, send)
            return
        act = Act(key_id="", action="", subject=without_keys(quote(scope["path"])))
        context = context_of(scope)
        unanswered = HTTPStatus.INTERNAL_SERVER_ERROR
        try:
            with on_behalf(act):
                await self._app(scope, receive, send)
        except CancelledError:  # by a stop: `Failures` answers it
            unanswered = HTTPStatus.SERVICE_UNAVAILABLE
            raise
        finally:
            status = context.status or unanswered.value
            if context.audited and status >= HTTPStatus.BAD_REQUEST and self._has_room(act.key_id):
                service = scope["app"].state.service
                failure = partial(_add_failure, service.store, act, status)
                await to_thread.run_sync(failure, limiter=service.pools.audit)

    def _has_room(self, key_id: str) -> bool:
        try:
            self._failures.take(key_id)
        except TooManyRequests:
            return False
        return True


def record_caller(request: Request, caller: Caller) -> None:
    """Record the caller and the action of a request."""
    act = current_act()
    if act is None:
        return
    route = request.scope["route"]
    act.key_id, act.action = caller.key_id, route.name
    act.map_slug = _slug_or_none(request.path_params.get("map"))
    # Localizing changes nothing that is stored.
    context_of(request.scope).audited = needed_by(route) != (KeyScope.LOCALIZE,)


def note(detail: str, *, map_slug: str | None = None) -> None:
    """Record what the path of a request does not show; call it before the change."""
    act = current_act()
    if act is not None:
        act.detail = without_keys(detail)
        act.map_slug = act.map_slug or _slug_or_none(map_slug)


def _slug_or_none(text: str | None) -> str | None:
    try:
        # An operator's key may be a name: `openssl rand -hex 32` makes such a one.
        return None if text is None else checked_slug(without_keys(text))
    except InvalidSlug:
        return None


def _add_failure(store: Store, act: Act, status: int) -> None:
    try:
        store.audit.append(act, str(status))
    except TensorMapError as error:
        # A failure of the storage, whose cause is no fault of ours, needs no trace.
        _log.error(
            "%s of %s by key %s ended in %d, which cannot be logged: %s",
            act.action,
            act.subject,
            act.key_id,
            status,
            with_cause(error),
            exc_info=None if isinstance(error, StorageFailure) else error,
        )
