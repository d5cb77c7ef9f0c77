# Made by make_sync.py: change _async instead.
"""A mapper: uploads recorded drives to a service and builds a map of them."""

import ssl
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import httpx2

from tensormap_client._sync.builds import follow, start_build
from tensormap_client._sync.capture_upload import upload_capture
from tensormap_client._sync.drive_requests import DriveRequests
from tensormap_client._sync.session import Session
from tensormap_client._sync.upload import upload_drive
from tensormap_client.captures import CaptureFiles
from tensormap_client.checks import require_slug
from tensormap_client.paths import revision_path
from tensormap_client.problems import MapExists
from tensormap_client.progress import NO_PROGRESS, Progress
from tensormap_client.sources import FolderSource, Source
from tensormap_client.uploaded import Uploaded


class Mapper(Session):
    """Uploads drives to one map of a service, and builds it.

    Args:
        url: The service's URL, for example `https://maps.example`.
        key: The API key, with scope `maps:write`; `None` if the service needs no key.
        map_slug: The map.
        timeout_s: How long to wait for an answer, and then for all of it, in seconds.
        patience_s: How long a failed request is retried, in seconds: the service restarts, or a
            limit is reached. Where the service has not answered this object before, a lost
            connection is not retried.
        tls: How to check the service's certificate, if not against the system's authorities.
        connections: HTTP transport to use instead of the network.
    """

    def __init__(
        self,
        url: str,
        key: str | None,
        map_slug: str,
        *,
        timeout_s: float = 120.0,
        patience_s: float = 300.0,
        tls: ssl.SSLContext | None = None,
        connections: httpx2.BaseTransport | None = None,
    ) -> None:
        require_slug("the map", map_slug)
        super().__init__(
            url,
            key,
            timeout_s=timeout_s,
            patience_s=patience_s,
            tls=tls,
            connections=connections,
        )
        self._slug = map_slug

    def create_map(self, description: str = "") -> bool:
        """Create the map if it does not exist, and return whether it was created.

        If the connection is lost meanwhile and the first request had created it, returns `False`.
        """
        try:
            self._sent("POST", "/v1/maps", {"map": self._slug, "description": description})
        except MapExists:
            return False
        return True

    def drive(self, drive_slug: str) -> Mapping[str, Any]:
        """Return a drive with its number of scans, of scans with poses, and more."""
        return DriveRequests(self._transport, self._slug, drive_slug).drive()

    def upload(
        self,
        source: Source | CaptureFiles | Path | str,
        drive_slug: str,
        progress: Progress = NO_PROGRESS,
    ) -> Uploaded:
        """Upload the scans of a recorded drive that the service lacks, several at a time.

        A capture or bag is sent as it is, in parts, and read by the service. Repeated after an
        interruption, it continues where the service says.

        Args:
            source: A capture or bag as `CaptureFiles.of` takes it, a folder of scans as
                `FolderSource` does, or another source.
            drive_slug: The drive's name in the map.
            progress: Receives each scan, or each part of a capture.

        Raises:
            OtherDrive: If the service's drive has scans that the source does not have, or was
                deleted meanwhile.
            NothingUsable: If no scan could be stored.
            CaptureFailed: If the service cannot read a capture.
            ClientError: If the service cannot be reached or rejects the upload.
            OSError: If a file cannot be read.
        """
        opened = _opened(Path(source)) if isinstance(source, Path | str) else source
        if isinstance(opened, CaptureFiles):
            return upload_capture(self._transport, self._slug, drive_slug, opened, progress)
        requests = DriveRequests(self._transport, self._slug, drive_slug)
        return upload_drive(requests, opened, progress)

    def build(
        self, parameters: Mapping[str, Any] | None = None, progress: Progress = NO_PROGRESS
    ) -> Mapping[str, Any]:
        """Build the map, wait for the end, and return the job; its `revision` is the result.

        Args:
            parameters: The body of `POST /v1/maps/{map}/builds`.
            progress: Receives the job's stages.

        Raises:
            BuildFailed: If the build fails or is cancelled.
            ClientError: If the service cannot be reached or rejects the build.
        """
        return self.finish_build(self.start_build(parameters), progress)

    def start_build(self, parameters: Mapping[str, Any] | None = None) -> Mapping[str, Any]:
        """Queue a build, and return its job; `parameters` as of `build`.

        Raises:
            ClientError: If the service cannot be reached or rejects the build.
        """
        return start_build(self._transport, self._slug, parameters)

    def finish_build(
        self, job: Mapping[str, Any], progress: Progress = NO_PROGRESS
    ) -> Mapping[str, Any]:
        """Wait for the end of a build that was queued, and return the job as `build` does.

        Raises:
            BuildFailed: If the build fails or is cancelled.
            ClientError: If the service cannot be reached.
        """
        return follow(self._transport, job, progress)

    def revision(self, revision: str) -> Mapping[str, Any]:
        """Return a revision of the map: its scans, segments, and whether it is live.

        The key needs the scope `maps:read`.
        """
        return self._get(revision_path(self._slug, revision))


def _opened(path: Path) -> Source | CaptureFiles:
    return CaptureFiles.of(path) or FolderSource(path)
