# Made by make_sync.py: change _async instead.
"""Keys, tokens and the audit log, as an administrator uses them."""

from collections.abc import Iterator, Sequence
from typing import Literal

from tensormap_client._sync.session import Session
from tensormap_client.answers import Answer
from tensormap_client.checks import require_several
from tensormap_client.paths import key_path
from tensormap_client.plain import given


class AccessAdmin(Session):
    """Administers access; `Admin` says what is raised."""

    def keys(self) -> Iterator[Answer]:
        """Yield the keys in the order in which they were made."""
        return self._pages("/v1/keys")

    def key(self, key: str) -> Answer:
        """Return a key, without its secret."""
        return self._get(key_path(key))

    def make_key(
        self,
        name: str,
        scopes: Sequence[str],
        maps: Sequence[str] | None = None,
        expires_at: str | None = None,
    ) -> Answer:
        """Make a key, and return it with its `secret`, which is nowhere else.

        Args:
            name: What the key is for.
            scopes: What the key allows, for example `localize`.
            maps: The maps that the key is limited to; `None` for all.
            expires_at: When the key expires, RFC 3339; `None` for never.
        """
        require_several("scopes", scopes)
        require_several("maps", maps)
        wanted = {"name": name, "scopes": list(scopes)}
        limits = {"maps": None if maps is None else list(maps), "expires_at": expires_at}
        return self._sent("POST", "/v1/keys", wanted | given(limits), repeats=False)

    def revoke_key(self, key: str) -> Answer:
        """Revoke a key at once and for good."""
        return self._sent("DELETE", key_path(key))

    def exchange_token(
        self,
        scopes: Sequence[str] | None = None,
        maps: Sequence[str] | None = None,
        expires_in_s: int | None = None,
    ) -> Answer:
        """Exchange the key of this object for a token, and return it with its `secret`.

        Args:
            scopes: What the token allows, no more than the key, and never `admin` or `metrics`;
                `None` for all that the key allows.
            maps: The maps that the token is limited to; `None` for those of the key.
            expires_in_s: How long the token is valid, from 60 to 3600 s; `None` for an hour.
        """
        require_several("scopes", scopes)
        require_several("maps", maps)
        limits = {
            "scopes": None if scopes is None else list(scopes),
            "maps": None if maps is None else list(maps),
            "expires_in_s": expires_in_s,
        }
        return self._sent("POST", "/v1/tokens", given(limits), repeats=False)

    def audit(
        self,
        *,
        map_slug: str | None = None,
        key: str | None = None,
        actions: Sequence[str] | None = None,
        since: str | None = None,
        until: str | None = None,
        order: Literal["oldest", "newest"] = "oldest",
        after: int | None = None,
    ) -> Iterator[Answer]:
        """Yield the requested changes with the key of each and its outcome.

        Args:
            map_slug: Only entries about this map.
            key: Only entries of this key, by its id.
            actions: Only entries with one of these actions, for example `delete_map`.
            since: Only entries of this time or later, RFC 3339.
            until: Only entries before this time, RFC 3339.
            order: Whether the oldest or the newest entry is the first.
            after: The entry after which, in this order, to begin; `None` for all.
        """
        require_several("actions", actions)
        chosen = {
            "map": map_slug,
            "key": key,
            "action": None if actions is None else list(actions),
            "since": since,
            "until": until,
            "order": None if order == "oldest" else order,
            "after": after,
        }
        return self._pages("/v1/audit", given(chosen))
