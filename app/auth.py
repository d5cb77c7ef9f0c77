"""Who may ask: everyone on this machine, or whoever holds a key."""

import hashlib
import hmac
import secrets
from dataclasses import dataclass
from typing import Annotated
from urllib.parse import urlsplit

from fastapi import Depends, Request
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer
from starlette.requests import HTTPConnection

from app.errors import HostNotAllowed, KeyNeeded, KeyRefused
from app.settings import Settings, is_loopback
from storage.store import Store

__all__ = ["Access", "make_admin_key", "open_access", "require_access"]

_ADMIN = "admin"
_bearer = HTTPBearer(auto_error=False, description="A key of this service.")


@dataclass(frozen=True)
class Access:
    """The keys that open the service.

    Attributes:
        key_hashes: SHA-256 of each valid key; without one, everyone on this machine may ask.
    """

    key_hashes: frozenset[str]

    def check(self, connection: HTTPConnection, key: str | None) -> None:
        """Let a request through or not.

        Raises:
            HostNotAllowed: If the service has no keys and is reached from elsewhere, or by a
                name that a page elsewhere could have pointed at this machine.
            KeyNeeded: If it has keys and none came.
            KeyRefused: If the key is not one of them.
        """
        if not self.key_hashes:
            self._check_is_local(connection)
        elif key is None:
            raise KeyNeeded("send a key of this service as `Authorization: Bearer KEY`")
        else:
            given = _hash(key)
            if not any(hmac.compare_digest(given, known) for known in self.key_hashes):
                raise KeyRefused("this service does not know the key that was sent")

    def check_stream(self, connection: HTTPConnection) -> None:
        """Let a stream through or not, before it is accepted.

        A browser lets any page open a stream to any host, and says only in `Origin` which page it
        was: without keys, pages from elsewhere are refused. With keys no page can send one.

        Raises:
            HostNotAllowed: As `check` does, and for a page from elsewhere.
            KeyNeeded: If the service has keys and none came.
            KeyRefused: If the key is not one of them.
        """
        scheme, _, key = connection.headers.get("authorization", "").partition(" ")
        bearer = key.strip() if scheme.lower() == "bearer" else ""
        self.check(connection, bearer or None)
        origin = connection.headers.get("origin")
        if not self.key_hashes and origin is not None:
            page = _host_of(origin)
            if not is_loopback(page):
                raise HostNotAllowed(
                    "a service without keys answers pages of this machine only, not of"
                    f" {origin[:80]!r}; set TENSORMAP_ADMIN_KEY"
                )

    @staticmethod
    def _check_is_local(connection: HTTPConnection) -> None:
        name = connection.url.hostname or ""
        address = (connection.scope.get("server") or ("",))[0]
        for reached_by in (name, address):
            if not is_loopback(reached_by):
                raise HostNotAllowed(
                    f"a service without keys answers on loopback only, not as {reached_by!r};"
                    " set TENSORMAP_ADMIN_KEY"
                )


def open_access(settings: Settings, store: Store) -> tuple[Access, str | None]:
    """Return who may ask, and a key that was made just now and must be shown once.

    The key of the settings opens the service, and no other: to set one is how a made key that was
    lost or seen is put out of use. Without one, on another address than loopback, the first start
    makes a key and keeps only its hash. Once a key was made it is asked for on loopback too.
    """
    if settings.admin_key is not None:
        return Access(frozenset({_hash(settings.admin_key.get_secret_value())})), None
    hashes = {key.secret_hash for key in store.keys.list() if key.revoked_at is None}
    made = None
    if not hashes and not is_loopback(settings.host):
        made = make_admin_key(store)
        hashes.add(_hash(made))
    return Access(frozenset(hashes)), made


def make_admin_key(store: Store) -> str:
    """Make an administrator's key, `tm_<id>_<secret>`, and keep its hash."""
    key = f"tm_{secrets.token_hex(4)}_{secrets.token_urlsafe(32)}"
    store.keys.add(_hash(key), [_ADMIN])
    return key


async def require_access(
    request: Request, bearer: Annotated[HTTPAuthorizationCredentials | None, Depends(_bearer)]
) -> None:
    """Check the key of a request; a dependency of every route under /v1."""
    access: Access = request.app.state.service.access
    access.check(request, None if bearer is None else bearer.credentials)


def _host_of(origin: str) -> str:
    try:
        return urlsplit(origin).hostname or ""
    except ValueError:
        return ""


def _hash(key: str) -> str:
    # A key holds 256 random bits or is the operator's own choice of at least 16 characters; it is
    # compared on every request, so a slow hash would only slow the service.
    return hashlib.sha256(key.encode()).hexdigest()
