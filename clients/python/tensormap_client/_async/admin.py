"""An administrator: maps, builds, revisions, keys and the audit trail of a service."""

from collections.abc import AsyncIterator, Mapping, Sequence
from typing import Any

from tensormap_client._async.builds import follow, start_build
from tensormap_client._async.session import AsyncSession
from tensormap_client.checks import require_number, require_several
from tensormap_client.paths import (
    drive_path,
    job_path,
    key_path,
    map_path,
    recycled_path,
    revision_path,
)
from tensormap_client.progress import NO_PROGRESS, Progress

Answer = Mapping[str, Any]
"""An answer of the service as JSON; docs/reference/http-api.md names its fields."""


class AsyncAdmin(AsyncSession):
    """Administers a service; each method needs its scope, and `admin` is all of them.

    Every method raises `Rejected` if the service rejects it (a subclass says why), `Unreachable` if
    it does not answer, and `InvalidArgument` if a name would lead to another resource, or is given
    in place of several, or a number of a fix is not finite. A request that would be another act the
    second time, as for a new key, is not repeated when its connection is lost, or when it is
    answered by 408, 502, 503 or 504 and may have been done: look whether it was.
    """

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

    async def delete_map(self, map_slug: str) -> None:
        """Delete a map with its drives, revisions and jobs, into the recycle bin."""
        await self._transport.request("DELETE", map_path(map_slug), repeats=False)

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

    def drives(self, map_slug: str) -> AsyncIterator[Answer]:
        """Yield a map's drives by name."""
        return self._pages(f"{map_path(map_slug)}/drives")

    async def delete_drive(self, map_slug: str, drive_slug: str) -> None:
        """Delete a drive and its scans, into the recycle bin."""
        path = drive_path(map_slug, drive_slug)
        await self._transport.request("DELETE", path, repeats=False)

    def recycle_bin(self) -> AsyncIterator[Answer]:
        """Yield what was deleted and can be restored, the last one first."""
        return self._pages("/v1/recycle-bin")

    async def restore(self, entry: str) -> Answer:
        """Restore a deleted map or drive."""
        return await self._sent("POST", f"{recycled_path(entry)}/restore", repeats=False)

    async def purge(self, entry: str) -> None:
        """Remove a deleted map or drive for good."""
        await self._transport.request("DELETE", recycled_path(entry), repeats=False)

    def jobs(self, map_slug: str | None = None) -> AsyncIterator[Answer]:
        """Yield the jobs, of all maps or of one, newest first."""
        return self._pages("/v1/jobs", None if map_slug is None else {"map": map_slug})

    async def build(
        self,
        map_slug: str,
        parameters: Mapping[str, Any] | None = None,
        progress: Progress = NO_PROGRESS,
    ) -> Answer:
        """Build a map, wait for the end, and return the job, with `revision`, `gate` and `notes`.

        Args:
            map_slug: The map.
            parameters: The body of `POST /v1/maps/{map}/builds`.
            progress: Receives the job's stages.

        Raises:
            BuildFailed: If the build fails, for example at the gate before live, or is cancelled.
        """
        return await self.follow(await self.start_build(map_slug, parameters), progress)

    async def start_build(
        self, map_slug: str, parameters: Mapping[str, Any] | None = None
    ) -> Answer:
        """Queue a build, and return its job."""
        return dict(await start_build(self._transport, map_slug, parameters))

    async def follow(self, job: Answer, progress: Progress = NO_PROGRESS) -> Answer:
        """Wait for a job's end and return it.

        Raises:
            BuildFailed: If it fails or is cancelled.
        """
        return await follow(self._transport, job, progress)

    async def cancel(self, job: str) -> Answer:
        """Cancel a job, and return it."""
        return await self._sent("DELETE", job_path(job))

    def revisions(self, map_slug: str) -> AsyncIterator[Answer]:
        """Yield a map's revisions, newest first."""
        return self._pages(f"{map_path(map_slug)}/revisions")

    async def revision(self, map_slug: str, revision: str) -> Answer:
        """Return a revision."""
        return await self._get(revision_path(map_slug, revision))

    async def comparison(self, map_slug: str, revision: str) -> Answer:
        """Compare a revision and its recall with the live one."""
        return await self._get(f"{revision_path(map_slug, revision)}/comparison")

    async def make_live(self, map_slug: str, revision: str) -> Answer:
        """Make a revision live, and return the map."""
        return await self._sent("PUT", f"{map_path(map_slug)}/live", {"revision": revision})

    async def delete_revision(self, map_slug: str, revision: str) -> None:
        """Remove a revision that is not live."""
        path = revision_path(map_slug, revision)
        await self._transport.request("DELETE", path, repeats=False)

    def keys(self) -> AsyncIterator[Answer]:
        """Yield the keys in the order in which they were made."""
        return self._pages("/v1/keys")

    async def make_key(
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
        known = {field: value for field, value in limits.items() if value is not None}
        return await self._sent("POST", "/v1/keys", wanted | known, repeats=False)

    async def revoke_key(self, key: str) -> Answer:
        """Revoke a key at once and for good."""
        return await self._sent("DELETE", key_path(key))

    def audit(self) -> AsyncIterator[Answer]:
        """Yield the requested changes, oldest first, with the key of each and its outcome."""
        return self._pages("/v1/audit")
