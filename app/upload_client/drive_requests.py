"""The requests of an upload, each for one drive of one map."""

import io
import math
import tarfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any
from urllib.parse import quote

import numpy as np

from app.upload_client.errors import Rejected
from app.upload_client.sources import ScanBody
from app.upload_client.transport import Transport
from core.arrays import Float32Array

_POSE_COLUMNS = "scan,x,y,z,qx,qy,qz,qw,timestamp_s"
_UNUSABLE = frozenset({413, 415, 422})
_NAMES = frozenset({"invalid-slug", "invalid-request"})


@dataclass(frozen=True)
class StoredScans:
    """Which scans of a drive are stored.

    Attributes:
        ranges: First and last index of each run, ascending.
        closed: Whether the drive takes no more.
    """

    ranges: tuple[tuple[int, int], ...] = ()
    closed: bool = False

    @property
    def count(self) -> int:
        """The number of stored scans."""
        return sum(last - first + 1 for first, last in self.ranges)


@dataclass(frozen=True)
class Unusable:
    """A scan that the service did not store.

    Attributes:
        index: In the drive.
        problem: The last word of its error's `type`.
        reason: What was expected and what was sent.
    """

    index: int
    problem: str
    reason: str


class DriveRequests:
    """Requests for one drive of a map.

    Args:
        transport: Of the service.
        map_slug: The map.
        drive_slug: The drive.
    """

    def __init__(self, transport: Transport, map_slug: str, drive_slug: str) -> None:
        self.map_slug, self.drive_slug = map_slug, drive_slug
        self._transport = transport
        self._map = f"/v1/maps/{quote(map_slug, safe='')}"
        self._drive = f"{self._map}/drives/{quote(drive_slug, safe='')}"

    def create_map(self) -> bool:
        """Create the map, and return whether it is new."""
        try:
            self._transport.request("POST", "/v1/maps", json={"map": self.map_slug})
        except Rejected as error:
            if error.problem != "map-exists":
                raise
            return False
        return True

    def stored(self) -> StoredScans:
        """Return which scans are stored, none of a drive that does not exist."""
        try:
            answer = self._transport.request("GET", f"{self._drive}/scans").json()
        except Rejected as error:
            if error.problem != "drive-not-found":
                raise
            return StoredScans()
        ranges = tuple((run["first"], run["last"]) for run in answer["present"])
        return StoredScans(ranges, answer["closed"])

    def drive(self) -> Mapping[str, Any]:
        """Return the drive."""
        return dict(self._transport.request("GET", self._drive).json())

    def returns_m(self, index: int) -> Float32Array | None:
        """Return the returns of a stored scan, `(n, 3)`; `None` if the service kept none."""
        try:
            answer = self._transport.request("GET", f"{self._drive}/scans/{index}")
        except Rejected as error:
            if error.problem != "returns-gone":
                raise
            return None
        points: Float32Array = np.load(io.BytesIO(answer.content), allow_pickle=False)
        return points

    def put_scan(self, scan: ScanBody) -> list[Unusable]:
        """Store one scan, with its time and pose where known; return it if it cannot be used."""
        known: dict[str, Any] = {}
        if math.isfinite(scan.timestamp_s):
            known["timestamp_s"] = repr(scan.timestamp_s)
        if scan.pose is not None:
            known["pose"] = ",".join(map(repr, scan.pose.as_tuple()))
        try:
            self._transport.request(
                "PUT",
                f"{self._drive}/scans/{scan.index}",
                content=scan.body,
                params=known,
                headers={"Content-Type": scan.media_type},
            )
        except Rejected as error:
            if error.problem in _NAMES or error.status not in {*_UNUSABLE, 409}:
                raise
            return [Unusable(scan.index, error.problem, error.detail)]
        return []

    def put_scans(self, scans: Sequence[ScanBody]) -> list[Unusable]:
        """Store scans of one media type in one body, and return those that cannot be used.

        Times and poses are sent before: a scan without its own gets them when it is stored.
        """
        rows = [row for scan in scans if (row := _pose_row(scan)) is not None]
        if rows:
            self._transport.request(
                "PUT",
                f"{self._drive}/poses",
                content="\n".join([_POSE_COLUMNS, *rows]).encode(),
                params={"partial": "true"},
                headers={"Content-Type": "application/vnd.tensormap.poses.csv"},
            )
        answer = self._transport.request(
            "POST",
            f"{self._drive}/scans",
            content=_tar(scans),
            params={"format": scans[0].media_type.rpartition(".")[2]},
            headers={"Content-Type": "application/x-tar"},
        )
        return [
            Unusable(int(PurePath(one["file"]).stem), one["type"].rpartition("/")[2], one["detail"])
            for one in answer.json()["set_aside"]
        ]

    def build(self, parameters: Mapping[str, Any], request_key: str) -> Mapping[str, Any]:
        """Queue a build and return its job; repeated with the same key it queues no other."""
        headers = {"Idempotency-Key": request_key}
        path = f"{self._map}/builds"
        return dict(
            self._transport.request("POST", path, json=dict(parameters), headers=headers).json()
        )

    def job(self, job: str) -> Mapping[str, Any]:
        """Return a job."""
        return dict(self._transport.request("GET", f"/v1/jobs/{job}").json())

    def revision(self, revision: str) -> Mapping[str, Any] | None:
        """Return a revision of the map; `None` if the key may not read it."""
        try:
            return dict(self._transport.request("GET", f"{self._map}/revisions/{revision}").json())
        except Rejected as error:
            if error.problem != "scope-missing":
                raise
            return None


def _pose_row(scan: ScanBody) -> str | None:
    """Return a scan's row in a table of poses, `None` if neither pose nor time is known."""
    timed = math.isfinite(scan.timestamp_s)
    if scan.pose is None and not timed:
        return None
    pose = [""] * 7 if scan.pose is None else map(repr, scan.pose.as_tuple())
    return ",".join([str(scan.index), *pose, repr(scan.timestamp_s) if timed else ""])


def _tar(scans: Sequence[ScanBody]) -> bytes:
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        for scan in scans:
            member = tarfile.TarInfo(f"{scan.index}.bin")
            member.size = len(scan.body)
            archive.addfile(member, io.BytesIO(scan.body))
    return file.getvalue()
