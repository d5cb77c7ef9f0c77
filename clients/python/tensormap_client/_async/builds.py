"""Builds, which are jobs: started, and followed until they end."""

import secrets
from collections.abc import Mapping
from typing import Any

from tensormap_client._async.transport import AsyncTransport
from tensormap_client.errors import BuildFailed, ClientError
from tensormap_client.io_async import sleep
from tensormap_client.paths import map_path
from tensormap_client.progress import Progress

_POLL_S = 0.5


async def start_build(
    transport: AsyncTransport, map_slug: str, parameters: Mapping[str, Any] | None
) -> Mapping[str, Any]:
    """Queue a build, and return its job; `parameters` are those of `POST /v1/maps/{map}/builds`.

    Raises:
        ClientError: If the service cannot be reached or rejects the build.
    """
    headers = {"Idempotency-Key": secrets.token_hex(16)}
    wanted = dict(parameters or {})
    return await transport.json(
        "POST", f"{map_path(map_slug)}/builds", json=wanted, headers=headers
    )


async def follow(
    transport: AsyncTransport,
    job: Mapping[str, Any],
    progress: Progress,
    failed: type[ClientError] = BuildFailed,
) -> Mapping[str, Any]:
    """Wait for a job's end and return it.

    Args:
        transport: The connections to the service.
        job: The job as the service returned it last.
        progress: Receives the job's stages.
        failed: The error to raise if the job fails or is cancelled.

    Raises:
        failed: If the job fails or is cancelled.
        ClientError: If the service cannot be reached.
    """
    stage, done = None, 0
    while True:
        if job["stage"]:  # a job that waits has none yet: the progress is of what was before it
            if (job["stage"], job["total"]) != stage or job["done"] < done:  # or the next drive's
                stage = job["stage"], job["total"]
                progress.start(*stage)
            done = job["done"]
            progress.move_to(done)
        if job["state"] == "done":
            return dict(job)
        if job["state"] in {"failed", "cancelled"}:
            why = (job["error"] or {}).get("detail", "")
            raise failed(f"{job['kind']} job {job['job']} {job['state']}: {why}".rstrip(": "))
        await sleep(_POLL_S)
        job = await transport.json("GET", f"/v1/jobs/{job['job']}")
