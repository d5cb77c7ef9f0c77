"""The caller of a request, and its permissions."""

from collections.abc import Collection
from dataclasses import dataclass, field
from typing import NoReturn

from app.access.scopes import Scope
from app.http.errors import ScopeMissing
from storage.errors import MapNotFound


@dataclass(frozen=True)
class Caller:
    """Who sent a request.

    Attributes:
        key_id: Id of the key; `operator` for the key of the settings, `everyone` without keys.
        scopes: What the key allows.
        maps: Slugs of the maps that it is limited to, `None` for all.
        key_hash: Hash of the key, `None` without keys.
        by_token: Whether a token was sent that was exchanged for the key.
    """

    key_id: str
    scopes: frozenset[Scope]
    maps: frozenset[str] | None = None
    key_hash: str | None = field(default=None, repr=False)
    by_token: bool = False

    def may(self, *scopes: Scope) -> bool:
        """Return whether one of these scopes is allowed."""
        return Scope.ADMIN in self.scopes or not self.scopes.isdisjoint(scopes)

    def require(self, scopes: Collection[Scope]) -> None:
        """Require one of these scopes.

        Raises:
            ScopeMissing: If the key has none of them.
        """
        if not self.may(*scopes):
            self._refuse(" or ".join(scopes), scopes)

    def require_all(self, scopes: Collection[Scope]) -> None:
        """Require all of these scopes.

        Raises:
            ScopeMissing: If the key lacks one of them.
        """
        if not all(self.may(scope) for scope in scopes):
            self._refuse(" and ".join(sorted(scopes)), scopes)

    def _refuse(self, needed: str, scopes: Collection[Scope]) -> NoReturn:
        held = f"{'token of ' if self.by_token else ''}key {self.key_id}"
        raise ScopeMissing(
            f"{held} allows {', '.join(sorted(self.scopes))}; this needs {needed}",
            scopes=tuple(scopes),
        )

    def sees(self, map_slug: str) -> bool:
        """Return whether a map is within the key's limits."""
        return self.maps is None or map_slug in self.maps

    def require_map(self, map_slug: str) -> None:
        """Require a map within the key's limits.

        Raises:
            MapNotFound: If it is another one: a key to some maps does not reveal which other maps
                exist.
        """
        if not self.sees(map_slug):
            raise MapNotFound(f"there is no map {map_slug[:80]!r}")

    def require_new_map(self, map_slug: str) -> None:
        """Require that a map to be made is within the key's limits.

        Raises:
            ScopeMissing: If it is another one, whether there is such a map or not.
        """
        if not self.sees(map_slug):
            raise ScopeMissing(
                f"key {self.key_id} is limited to maps {', '.join(sorted(self.maps or ()))};"
                f" it cannot make {map_slug[:80]!r}"
            )
