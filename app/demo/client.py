"""The client of the demonstration's vehicles."""

import time
from typing import Any

import httpx2
import numpy as np

from app.builds.job_schemas import JobOut
from app.builds.parameters import BuildParameters
from app.demo.errors import DemoFailed
from app.localization.schemas import LocalizationOut
from app.revisions.schemas import BasisOut
from app.revisions.topology_schemas import TopologyOut
from core.scans.scan import Scan
from storage.catalog import JobState

_TYPES = {
    "scan": "application/vnd.tensormap.kitti",
    "signature": "application/vnd.tensormap.signature",
}
_POLL_S = 0.1


class Client(httpx2.Client):
    """A connection to a service, for one map."""

    def __init__(self, url: str, map_slug: str) -> None:
        super().__init__(base_url=url, timeout=60.0)
        self._map = f"/v1/maps/{map_slug}"
        self._slug = map_slug

    def create_map(self, description: str) -> None:
        """Create the map."""
        self._checked("POST", "/v1/maps", json={"map": self._slug, "description": description})

    def put_scan(self, drive: str, index: int, body: bytes, scan: Scan) -> None:
        """Store one scan, with its time and pose where known."""
        known: dict[str, Any] = {}
        if np.isfinite(scan.timestamp_s):
            known["timestamp_s"] = scan.timestamp_s
        if scan.pose is not None:
            known["pose"] = ",".join(map(repr, scan.pose.as_tuple()))
        self._checked(
            "PUT",
            f"{self._map}/drives/{drive}/scans/{index}",
            params=known,
            content=body,
            headers={"Content-Type": _TYPES["scan"]},
        )

    def build(self, parameters: BuildParameters) -> JobOut:
        """Queue a build."""
        answer = self._checked("POST", f"{self._map}/builds", json=parameters.as_json())
        return JobOut.model_validate_json(answer.content)

    def follow(self, job: JobOut) -> JobOut:
        """Return the state of a job after a short wait.

        Raises:
            DemoFailed: If it failed.
        """
        time.sleep(_POLL_S)
        now = JobOut.model_validate_json(self._checked("GET", f"/v1/jobs/{job.job}").content)
        if now.state in {JobState.FAILED, JobState.CANCELLED}:
            raise DemoFailed(f"the build is {now.state}: {now.error}")
        return now

    def mapped_scans(self) -> int:
        """Return the number of scans of the live revision."""
        live = self._checked("GET", self._map).json()["live_revision"]
        scans: int = self._checked("GET", f"{self._map}/revisions/{live}").json()["scans"]
        return scans

    def basis(self) -> BasisOut:
        """Download the basis."""
        return BasisOut.model_validate_json(self._checked("GET", f"{self._map}/basis").content)

    def topology(self) -> TopologyOut:
        """Download the graph."""
        return TopologyOut.model_validate_json(
            self._checked("GET", f"{self._map}/topology").content
        )

    def localize(self, kind: str, body: bytes) -> LocalizationOut:
        """Localize a scan or packed signatures.

        Args:
            kind: `scan` or `signature`.
            body: Of the request.
        """
        answer = self._checked(
            "POST",
            f"{self._map}/localizations/{kind}",
            content=body,
            headers={"Content-Type": _TYPES[kind]},
        )
        return LocalizationOut.model_validate_json(answer.content)

    def _checked(self, method: str, path: str, **parts: Any) -> httpx2.Response:  # noqa: ANN401
        answer = self.request(method, path, **parts)
        if not answer.is_success:
            raise DemoFailed(f"{method} {path}: {answer.status_code} {answer.text}")
        return answer
