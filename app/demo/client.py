"""What vehicles do over HTTP."""

import time
from typing import Any, Self

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

_KITTI = "application/vnd.tensormap.kitti"
_SIGNATURE = "application/vnd.tensormap.signature"
_POLL_S = 0.1


class Client:
    """One connection to a service, for one map."""

    def __init__(self, url: str, map_slug: str) -> None:
        self._http = httpx2.Client(base_url=url, timeout=60.0)
        self._map = f"/v1/maps/{map_slug}"
        self._slug = map_slug

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._http.close()

    def create_map(self, description: str) -> None:
        """Make the map."""
        self._ask("POST", "/v1/maps", json={"map": self._slug, "description": description})

    def put_scan(self, drive: str, index: int, body: bytes, scan: Scan) -> None:
        """Store one scan with the time and pose that are known of it."""
        known: dict[str, Any] = {}
        if np.isfinite(scan.timestamp_s):
            known["timestamp_s"] = scan.timestamp_s
        if scan.pose is not None:
            known["pose"] = ",".join(map(repr, scan.pose.as_tuple()))
        self._ask(
            "PUT",
            f"{self._map}/drives/{drive}/scans/{index}",
            params=known,
            content=body,
            headers={"Content-Type": _KITTI},
        )

    def build(self, parameters: BuildParameters) -> JobOut:
        """Queue a build."""
        answer = self._ask("POST", f"{self._map}/builds", json=parameters.as_json())
        return JobOut.model_validate_json(answer.content)

    def follow(self, job: JobOut) -> JobOut:
        """Wait a moment and return how far a job is.

        Raises:
            DemoFailed: If it failed.
        """
        time.sleep(_POLL_S)
        now = JobOut.model_validate_json(self._ask("GET", f"/v1/jobs/{job.job}").content)
        if now.state in {JobState.FAILED, JobState.CANCELLED}:
            raise DemoFailed(f"the build is {now.state}: {now.error}")
        return now

    def mapped_scans(self) -> int:
        """Return how many scans the live revision holds."""
        live = self._ask("GET", self._map).json()["live_revision"]
        scans: int = self._ask("GET", f"{self._map}/revisions/{live}").json()["scans"]
        return scans

    def basis(self) -> BasisOut:
        """Download what signatures are made with."""
        return BasisOut.model_validate_json(self._ask("GET", f"{self._map}/basis").content)

    def topology(self) -> TopologyOut:
        """Download the graph."""
        return TopologyOut.model_validate_json(self._ask("GET", f"{self._map}/topology").content)

    def localize_scan(self, body: bytes) -> LocalizationOut:
        """Ask with a whole scan."""
        return self._localize("scan", body, _KITTI)

    def localize_signature(self, packed: bytes) -> LocalizationOut:
        """Ask with packed signatures."""
        return self._localize("signature", packed, _SIGNATURE)

    def _localize(self, by: str, body: bytes, media_type: str) -> LocalizationOut:
        answer = self._ask(
            "POST",
            f"{self._map}/localizations/{by}",
            content=body,
            headers={"Content-Type": media_type},
        )
        return LocalizationOut.model_validate_json(answer.content)

    def _ask(self, method: str, path: str, **parts: Any) -> httpx2.Response:  # noqa: ANN401
        answer = self._http.request(method, path, **parts)
        if not answer.is_success:
            raise DemoFailed(f"{method} {path}: {answer.status_code} {answer.text}")
        return answer
