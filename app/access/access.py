"""Authentication: everyone on this machine while there are no keys, then holders of keys."""

import hmac
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from urllib.parse import urlsplit

from starlette.requests import HTTPConnection

from app.access.caller import Caller
from app.access.rate_limits import BYTES, RateLimits
from app.access.scopes import Scope as KeyScope
from app.access.secrets import is_token, is_well_formed, new_secret, secret_hash
from app.http.context import RequestContext, context_of
from app.http.errors import BodyTooLarge, HostNotAllowed, KeyNeeded, KeyRefused
from app.settings import Settings, is_loopback
from storage.catalog import (
    EVERYONE_ID,
    OPERATOR_ID,
    SERVICE_ID,
    Act,
    KeyRecord,
    TokenRecord,
    on_behalf,
)
from storage.catalog.pages import all_items
from storage.store import Store

_DAY_S = 86_400
_MOMENT = "%Y-%m-%dT%H:%M:%SZ"
_FORWARDED = frozenset({"forwarded", "x-forwarded-for"})  # proxies name their client in these


class Access:
    """The keys of the service; each request looks its key up, so that revoking works at once.

    The catalog keeps the record in memory until anything in it changes.

    While no key was ever made, and the settings have none, everyone on this machine has access.

    Args:
        store: The store that keeps the keys.
        settings: The service's settings: the administrator's key, limits of each key, allowed
            origins.
    """

    def __init__(self, store: Store, settings: Settings) -> None:
        self._store = store
        self._allowed_origins = frozenset(settings.allowed_origins)
        self._limits = RateLimits(settings.requests_per_s, settings.request_burst)
        daily = settings.upload_bytes_per_day
        self._quota = RateLimits(daily / _DAY_S, daily, unit=BYTES)
        key = settings.admin_key
        self._operator_hash = None if key is None else secret_hash(key.get_secret_value())
        self._has_keys = False  # once true it stays true

    @property
    def is_open(self) -> bool:
        """Whether there is no key yet."""
        if self._operator_hash is None and not self._has_keys:
            self._has_keys = self._store.keys.ever_made()
        return self._operator_hash is None and not self._has_keys

    def caller_of(self, connection: HTTPConnection) -> Caller:
        """Return who sent a request; called from a thread, because it reads the catalog.

        Raises:
            HostNotAllowed: If the service has no keys and is reached from another machine, through
                a proxy, by a name that a foreign page could have pointed at this machine, or from
                such a page.
            KeyNeeded: If it has keys and none was sent.
            KeyRefused: If the key is unknown, or no longer valid.
        """
        if self.is_open:
            _require_local(connection, self._allowed_origins)
            return Caller(EVERYONE_ID, frozenset({KeyScope.ADMIN}))
        sent = _bearer_of(connection)
        if not sent:
            raise KeyNeeded("send a key of this service as `Authorization: Bearer KEY`")
        return self._holder(sent)

    def admit(self, connection: HTTPConnection) -> Caller:
        """Return who sent a request, and count it against the sender's limit.

        Requests without a valid key are counted by address.

        Raises:
            TooManyRequests: If the sender has reached its limit.
            TensorMapError: What `caller_of` raises.
        """
        context = context_of(connection.scope)
        try:
            caller = self.caller_of(connection)
        except (KeyNeeded, KeyRefused):
            context.allow(self._limits.take(context.sender))
            raise
        if caller.key_id != EVERYONE_ID:
            context.sender = caller.key_id
        context.allow(self._limits.take(context.sender))
        context.caller = caller
        return caller

    def require_quota(self, context: RequestContext, amount: int) -> None:
        """Require that the daily quota of a sender allows a body that is not received yet.

        Args:
            context: The request's context; a request that needs no key has no quota.
            amount: Number of bytes.

        Raises:
            TooManyRequests: If they exceed the rest of the quota.
            BodyTooLarge: If they exceed the whole quota.
        """
        if context.caller is None:
            return
        self._require_parts(f"{amount} bytes", amount)
        context.allow(self._quota.require(context.sender, amount))

    def spend_bytes(self, context: RequestContext, amount: int, received: int) -> None:
        """Count received bytes of a body, or of a stream's message, against the sender's quota.

        Args:
            context: The request's context; a request that needs no key has no quota.
            amount: Number of bytes.
            received: Number of bytes of this body until now, these included.

        Raises:
            TooManyRequests: If they exceed the rest of the quota.
            BodyTooLarge: If the body exceeds the whole quota.
        """
        if context.caller is None:
            return
        self._require_parts(f"{received} bytes or more", received)
        context.allow(self._quota.take(context.sender, amount))

    def _require_parts(self, size: str, amount: int) -> None:
        if self._quota.never_allows(amount):
            raise BodyTooLarge(
                f"the body has {size}, more than a key may send in a day: send it in parts"
            )

    def _holder(self, sent: str) -> Caller:
        given = secret_hash(sent)
        if self._operator_hash is not None and hmac.compare_digest(given, self._operator_hash):
            return Caller(OPERATOR_ID, frozenset({KeyScope.ADMIN}), key_hash=given)
        if not is_well_formed(sent):
            raise _unknown()
        # The hash of 256 random bits is looked up: the time this takes reveals nothing about them.
        return self._holder_of_token(given) if is_token(sent) else self._holder_of_key(given)

    def _holder_of_key(self, given: str) -> Caller:
        key = self._store.keys.with_hash(given)
        if key is None or not hmac.compare_digest(given, key.secret_hash):
            raise _unknown()
        self._require_in_use(key)
        return _caller(key.id, key, given)

    def _holder_of_token(self, given: str) -> Caller:
        token, key = self._store.tokens.with_hash(given) or (None, None)
        if token is None or not hmac.compare_digest(given, token.secret_hash):
            raise _unknown()
        if datetime.now(UTC) >= token.expires_at:
            raise KeyRefused(f"token {token.id} expired at {token.expires_at:{_MOMENT}}")
        if key is not None:
            self._require_in_use(key)
        elif token.key_hash != self._operator_hash:
            raise KeyRefused(f"the key of token {token.id} is no longer that of the settings")
        caller = _caller(OPERATOR_ID if key is None else key.id, token, token.key_hash)
        return replace(caller, by_token=True)

    def refusal_of(self, key: KeyRecord) -> str | None:
        """Return why a key is not accepted now, `None` if it is."""
        if key.revoked_at is not None:
            return f"key {key.id} was revoked at {key.revoked_at:{_MOMENT}}"
        if not key.opens_at(datetime.now(UTC)):
            return f"key {key.id} expired at {key.expires_at:{_MOMENT}}"
        if key.first_run and self._operator_hash is not None:
            # Setting a key disables the generated one, which may be lost or compromised.
            return f"key {key.id} is out of use while TENSORMAP_ADMIN_KEY is set"
        return None

    def _require_in_use(self, key: KeyRecord) -> None:
        if refusal := self.refusal_of(key):
            raise KeyRefused(refusal)


def sent_hash(connection: HTTPConnection) -> str:
    """Return the hash of the key or token that was sent, valid or not, or of an empty one."""
    return secret_hash(_bearer_of(connection))


def _caller(key_id: str, held: KeyRecord | TokenRecord, key_hash: str) -> Caller:
    maps = None if held.maps is None else frozenset(held.maps)
    return Caller(key_id, frozenset(map(KeyScope, held.scopes)), maps, key_hash)


def _unknown() -> KeyRefused:
    return KeyRefused("this service does not know the key that was sent")


def make_first_key(store: Store, settings: Settings, show: Callable[[str], object]) -> None:
    """Make the administrator's first key where one is needed, and show it once.

    It is needed on any address but loopback if neither the settings nor the catalog have an
    administrator's key. Only its hash is kept, and not before it is shown: after a start that fails
    in between the next one shows another key, else nobody would have the one that is kept.

    Args:
        store: The store that keeps it.
        settings: The settings.
        show: Shows its text.
    """
    if settings.admin_key or is_loopback(settings.host) or _has_administrator(store):
        return
    made = new_secret()
    show(made.text)
    detail = f"key {made.id}: {KeyScope.ADMIN} of all maps"
    with on_behalf(Act(SERVICE_ID, "make_key", "/v1/keys", detail=detail)):
        store.keys.add(
            secret_hash(made.text),
            [KeyScope.ADMIN],
            key_id=made.id,
            name="administrator",
            first_run=True,
        )


def _has_administrator(store: Store) -> bool:
    now, keys = datetime.now(UTC), all_items(store.keys.list)
    return any(KeyScope.ADMIN in key.scopes and key.opens_at(now) for key in keys)


def _bearer_of(connection: HTTPConnection) -> str:
    scheme, _, sent = connection.headers.get("authorization", "").partition(" ")
    return sent.strip() if scheme.lower() == "bearer" else ""


def _require_local(connection: HTTPConnection, allowed_origins: frozenset[str]) -> None:
    """Reject requests from other machines and from pages of other sites.

    A browser lets any page send simple requests and open streams to any host, and names the page
    only in `Origin`. A proxy on this machine may forward anybody's request under a loopback name.
    """
    if not _FORWARDED.isdisjoint(connection.headers):
        raise HostNotAllowed(
            "a service without keys answers this machine only, and this request came through a"
            " proxy; set TENSORMAP_ADMIN_KEY"
        )
    address = (connection.scope.get("server") or ("",))[0]
    reached_by = {address: address}
    if (sent := connection.headers.get("host")) is not None:
        # Not of `connection.url`, which has the server's address where the header is no host.
        reached_by = {sent: _host_of(f"//{sent}"), **reached_by}
    for shown, host in reached_by.items():
        if not is_loopback(host):
            raise HostNotAllowed(
                f"a service without keys answers on loopback only, not as {shown[:80]!r};"
                " set TENSORMAP_ADMIN_KEY"
            )
    origin = connection.headers.get("origin")
    if origin is None or origin in allowed_origins:
        return
    if not is_loopback(_host_of(origin)):
        raise HostNotAllowed(
            "a service without keys answers pages of this machine only, not of"
            f" {origin[:80]!r}; set TENSORMAP_ADMIN_KEY"
        )


def _host_of(url: str) -> str:
    """Return the host of a URL, empty if it has none or is invalid."""
    try:
        return urlsplit(url).hostname or ""
    except ValueError:
        return ""
