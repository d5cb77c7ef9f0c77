# Made by make_sync.py: change _async instead.
"""An upload of a capture in parts, until the service has read it."""

import base64
import hashlib
from collections import deque
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

from tensormap_client._sync.builds import follow
from tensormap_client._sync.transport import Transport
from tensormap_client.captures import CaptureFiles
from tensormap_client.errors import CaptureFailed
from tensormap_client.io_sync import Work, Workers, computed
from tensormap_client.paths import drive_path
from tensormap_client.progress import HASHING, Progress
from tensormap_client.uploaded import Uploaded

_MOST_REQUESTS = 4
# What was on its way when a client is killed is sent again: at most 1 % of the capture.
_PARTS_PER_REQUEST = 100
_STEP_BYTES = 16 * 2**20


def upload_capture(
    transport: Transport,
    map_slug: str,
    drive_slug: str,
    capture: CaptureFiles,
    progress: Progress,
) -> Uploaded:
    """Store the scans of a capture: send the parts that the service lacks, and have it read them.

    Repeated after an interruption, it continues where the service says.

    Args:
        transport: The connections to the service.
        map_slug: The map.
        drive_slug: The drive.
        capture: The files.
        progress: Receives each step of the files' digest, each part, and then the stages of the job
            that reads them.

    Raises:
        CaptureFailed: If the service cannot read the capture.
        ClientError: If the service cannot be reached or rejects the upload.
        OSError: If a file cannot be read.
    """
    drive = drive_path(map_slug, drive_slug)
    files = zip(capture.files, capture.sizes, strict=True)
    wanted = {
        "files": [{"name": file.name, "size_bytes": size} for file, size in files],
        "topic": capture.topic,
        "sha256": _sha256(capture, progress),
    }
    begun = transport.json("POST", f"{drive}/captures", json=wanted)
    path = f"{drive}/captures/{begun['capture']}"
    sent_bytes = _send(transport, path, begun, capture, progress)
    change = {"complete": True, "topic": capture.topic}
    queued = transport.json("PATCH", path, json=change)
    begun_job = transport.json("GET", f"/v1/jobs/{queued['job']}")
    job = follow(transport, begun_job, progress, CaptureFailed)
    scans = (transport.json("GET", path))["scans"]
    present, stored = scans["present"], scans["stored"]
    if begun["state"] == "done":  # it was read before: nothing of it is new
        present, stored = present + stored, 0
    return Uploaded(
        scans["scans"],
        present,
        stored,
        sent_bytes,
        scans["skipped"],
        notes=tuple(job["notes"]),
    )


def _sha256(capture: CaptureFiles, progress: Progress) -> str:
    """Return the SHA-256 of all bytes, hex; in steps, for which alone a cancelled caller waits."""
    digest, begins = hashlib.sha256(), range(0, sum(capture.sizes), _STEP_BYTES)
    progress.start(HASHING, len(begins))
    for begin in begins:
        computed(partial(_add, digest, capture, begin))
        progress.advance()
    return digest.hexdigest()


def _add(digest: "hashlib._Hash", capture: CaptureFiles, begin: int) -> None:
    digest.update(capture.part(begin, _STEP_BYTES))


def _send(
    transport: Transport,
    path: str,
    begun: Mapping[str, Any],
    capture: CaptureFiles,
    progress: Progress,
) -> int:
    """Send the missing parts, several at a time; return the number of their bytes."""
    parts, part_bytes = begun["parts"], begun["part_bytes"]
    missing = list(_numbers(begun["missing"]))
    progress.start("uploading", parts)
    progress.move_to(parts - len(missing))

    def put(number: int) -> int:
        content = computed(lambda: capture.part(number * part_bytes, part_bytes))
        digest = base64.b64encode(hashlib.sha256(content).digest()).decode()
        headers = {
            "Content-Type": "application/octet-stream",
            "Content-Digest": f"sha-256=:{digest}:",
        }
        transport.request("PUT", f"{path}/parts/{number}", content=content, headers=headers)
        return len(content)

    sent_bytes = 0
    at_once = min(max(parts // _PARTS_PER_REQUEST, 1), _MOST_REQUESTS)
    sending: deque[Work[int]] = deque()
    with Workers(at_once) as workers:
        while missing or sending:
            while missing and len(sending) < at_once:
                sending.append(workers.start(put, missing.pop(0)))
            size_bytes = sending.popleft().result()
            sent_bytes += size_bytes
            progress.sent(size_bytes)
            progress.advance()
    return sent_bytes


def _numbers(ranges: list[Mapping[str, int]]) -> Iterator[int]:
    for run in ranges:
        yield from range(run["first"], run["last"] + 1)
