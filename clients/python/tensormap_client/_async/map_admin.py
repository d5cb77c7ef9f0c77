"""Maps, their anchors, and the recycle bin, as an administrator uses them."""

from collections.abc import AsyncIterator, Mapping, Sequence
from typing import Any

from tensormap_client._async.session import AsyncSession
from tensormap_client.answers import Answer
from tensormap_client.checks import require_number
from tensormap_client.paths import map_path, recycled_path


class AsyncMapAdmin(AsyncSession):
    """Administers maps; `AsyncAdmin` says what is raised."""

    def maps(self) -> AsyncIterator[Answer]:
        """Yield the maps by name."""
        return self._pages("/v1/maps")

    async def map(self, map_slug: str) -> Answer:
        """Return a map."""
        return await self._get(map_path(map_slug))

    async def create_map(self, map_slug: str, description: str = "") -> Answer:
        """Create a map, and return it."""
        wanted = {"map": map_slug, "description": description}
        return await self._sent("POST", "/v1/maps", wanted, repeats=False)

    async def update_map(self, map_slug: str, changes: Mapping[str, Any]) -> Answer:
        """Change a map's description, retention or anchor, and return the map.

        Args:
            map_slug: The map.
            changes: The body of `PATCH /v1/maps/{map}`; what it does not name stays as it is.
        """
        return await self._sent("PATCH", map_path(map_slug), dict(changes))

    async def delete_map(self, map_slug: str, *, purge: bool = False) -> None:
        """Delete a map with its drives, revisions and jobs, into the recycle bin.

        Args:
            map_slug: The map.
            purge: Whether to remove it for good; that needs the scope `admin`.
        """
        await self._deleted(map_path(map_slug), purge=purge)

    async def fit_anchor(
        self, map_slug: str, drive_slug: str, fixes: Sequence[Mapping[str, float]]
    ) -> Answer:
        """Fit the map's place on the Earth to GNSS fixes of a drive, and return the map.

        Args:
            map_slug: The map.
            drive_slug: A drive of its live revision.
            fixes: At most 9,000 fixes, each with `time_s` by the clock of the drive's scans,
                `latitude_deg`, `longitude_deg` and, if known, `altitude_m` and `accuracy_m`.
        """
        for index, fix in enumerate(fixes):
            for name, value in fix.items():
                if isinstance(value, float):  # NaN, as ROS has it for an altitude, is not in JSON
                    require_number(f"fixes[{index}][{name!r}]", value)
        track = {"drive": drive_slug, "fixes": [dict(fix) for fix in fixes]}
        return await self._sent("POST", f"{map_path(map_slug)}/anchor", track)

    def recycle_bin(self) -> AsyncIterator[Answer]:
        """Yield what was deleted and can be restored, the last one first."""
        return self._pages("/v1/recycle-bin")

    async def restore(self, entry: str, name: str | None = None) -> Answer:
        """Restore a deleted map or drive, under another name if one is given."""
        params = None if name is None else {"name": name}
        path = f"{recycled_path(entry)}/restore"
        return await self._sent("POST", path, params=params, repeats=False)

    async def purge(self, entry: str) -> None:
        """Remove a deleted map or drive for good."""
        await self._deleted(recycled_path(entry))
