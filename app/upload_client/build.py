"""A build that a client requests and waits for."""

import secrets
import time
from collections.abc import Callable, Mapping
from typing import Any

from app.upload_client.drive_requests import DriveRequests
from app.upload_client.errors import BuildFailed
from app.upload_client.upload import UploadProgress

_POLL_S = 0.5


def build_map(
    requests: DriveRequests,
    parameters: Mapping[str, Any],
    progress: UploadProgress,
    wait: Callable[[float], None] = time.sleep,
) -> Mapping[str, Any]:
    """Build a map, wait for the end, and return the job.

    Args:
        requests: For a drive of the map.
        parameters: Of the build.
        progress: Receives its stages.
        wait: Waits so many seconds.

    Raises:
        BuildFailed: If it fails or is cancelled.
        UploadFailed: If the service cannot be reached or rejects the build.
    """
    job = requests.build(parameters, secrets.token_hex(16))
    stage = None
    while True:
        if job["stage"] and job["stage"] != stage:
            stage = job["stage"]
            progress.start(stage, job["total"])
        progress.move_to(job["done"])
        if job["state"] == "done":
            return job
        if job["state"] in {"failed", "cancelled"}:
            why = (job["error"] or {}).get("detail", "")
            raise BuildFailed(f"build {job['job']} {job['state']}: {why}".rstrip(": "))
        wait(_POLL_S)
        job = requests.job(job["job"])
