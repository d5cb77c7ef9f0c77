# Made by make_sync.py: change _async instead.
"""Jobs and builds, as an administrator uses them."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from tensormap_client._sync.builds import follow, start_build
from tensormap_client._sync.session import Session
from tensormap_client.answers import Answer
from tensormap_client.checks import require_several
from tensormap_client.paths import job_path
from tensormap_client.plain import given
from tensormap_client.progress import NO_PROGRESS, Progress


class JobAdmin(Session):
    """Administers jobs; `Admin` says what is raised."""

    def jobs(
        self, map_slug: str | None = None, states: Sequence[str] | None = None
    ) -> Iterator[Answer]:
        """Yield the jobs, newest first.

        Args:
            map_slug: Only those of this map.
            states: Only those in one of these states, for example `queued`.
        """
        require_several("states", states)
        chosen = {"map": map_slug, "state": None if states is None else list(states)}
        return self._pages("/v1/jobs", given(chosen))

    def job(self, job: str) -> Answer:
        """Return a job and its progress."""
        return self._get(job_path(job))

    def build(
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
        return self.follow(self.start_build(map_slug, parameters), progress)

    def start_build(self, map_slug: str, parameters: Mapping[str, Any] | None = None) -> Answer:
        """Queue a build, and return its job."""
        return dict(start_build(self._transport, map_slug, parameters))

    def follow(self, job: Answer, progress: Progress = NO_PROGRESS) -> Answer:
        """Wait for a job's end and return it.

        Raises:
            BuildFailed: If it fails or is cancelled.
        """
        return follow(self._transport, job, progress)

    def cancel(self, job: str) -> Answer:
        """Cancel a job, and return it."""
        return self._sent("DELETE", job_path(job))
