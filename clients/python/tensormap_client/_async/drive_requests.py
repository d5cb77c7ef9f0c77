"""The requests of an upload, each for one drive of one map."""

import io
import tarfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from http import HTTPStatus
from pathlib import Path, PurePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tensormap_client._async.transport import AsyncTransport
from tensormap_client.errors import OtherDrive, Rejected
from tensormap_client.paths import drive_path
from tensormap_client.problems import (
    DriveNotFound,
    InvalidRequest,
    InvalidSlug,
    NothingStored,
    ReturnsGone,
)
from tensormap_client.sources import ScanBody
from tensormap_client.uploaded import Put, StoredScans, Unusable

_POSE_COLUMNS = "scan,x,y,z,qx,qy,qz,qw,timestamp_s"
_UNUSABLE = frozenset({409, 413, 415, 422})
_TAR = "application/x-tar"


class AsyncDriveRequests:
    """Requests for one drive of a map.

    Args:
        transport: The connections to the service.
        map_slug: The map.
        drive_slug: The drive.
    """

    def __init__(self, transport: AsyncTransport, map_slug: str, drive_slug: str) -> None:
        self.drive_slug = drive_slug
        self._transport = transport
        self._drive = drive_path(map_slug, drive_slug)

    async def stored(self) -> StoredScans:
        """Return which scans are stored, none of a drive that does not exist.

        Raises:
            Unreachable: If what answers is another service.
        """
        try:
            answer = await self._transport.json("GET", f"{self._drive}/scans")
            ranges = tuple((run["first"], run["last"]) for run in answer["present"])
            return StoredScans(ranges, answer["scans_with_pose"])
        except DriveNotFound:
            return StoredScans()

    async def drive(self) -> Mapping[str, Any]:
        """Return the drive."""
        return dict(await self._transport.json("GET", self._drive))

    async def returns_m(self, index: int) -> NDArray[np.float32] | None:
        """Return the returns of a stored scan, `(n, 3)`; `None` if the service kept none."""
        try:
            path = f"{self._drive}/scans/{index}"
            answer = await self._transport.request("GET", path, is_download=True)
        except ReturnsGone:
            return None
        points: NDArray[np.float32] = np.load(io.BytesIO(answer.content), allow_pickle=False)
        return points

    async def pose_and_time(self, index: int) -> tuple[Sequence[float] | None, float | None]:
        """Return pose and time of a stored scan, each `None` if unknown.

        Raises:
            OtherDrive: If it is not stored any more.
        """
        params = {"first": index, "limit": 1}
        answer = await self._transport.json("GET", f"{self._drive}/poses", params=params)
        for scan in answer["poses"]:
            if scan["scan"] == index:
                return scan["pose"], scan["timestamp_s"]
        raise OtherDrive(f"drive {self.drive_slug!r} has no scan {index} any more: upload again")

    async def put_scan(self, scan: ScanBody) -> Put:
        """Store one scan, with its time and pose where known."""
        known: dict[str, Any] = {}
        if scan.timestamp_s is not None:
            known["timestamp_s"] = _digits(scan.timestamp_s)
        if scan.pose is not None:
            known["pose"] = ",".join(map(_digits, scan.pose))
        try:
            answer = await self._transport.request(
                "PUT",
                f"{self._drive}/scans/{scan.index}",
                content=scan.body,
                params=known,
                headers={"Content-Type": scan.media_type},
            )
        except Rejected as error:
            if (
                isinstance(error, InvalidSlug | InvalidRequest)
                or error.status not in _UNUSABLE
                or not error.problem  # a proxy refuses it, as one that takes 1 MB at most
            ):
                raise
            return Put(0, (Unusable(str(scan.index), error.problem, error.detail),))
        return Put(int(answer.status_code == HTTPStatus.OK))

    async def put_scans(self, scans: Sequence[ScanBody]) -> Put:
        """Store scans of one media type in one body.

        Times and poses are sent before: a scan without its own gets them when it is stored.
        """
        rows = [row for scan in scans if (row := _pose_row(scan)) is not None]
        if rows:
            await self._transport.request(
                "PUT",
                f"{self._drive}/poses",
                content="\n".join([_POSE_COLUMNS, *rows]).encode(),
                params={"partial": "true"},
                headers={"Content-Type": "application/vnd.tensormap.poses.csv"},
            )
        named = [(f"{scan.index}.bin", scan.body) for scan in scans]
        put = await self._put_tar(named, {"format": scans[0].media_type.rpartition(".")[2]})
        unusable = (replace(one, file=PurePath(one.file).stem) for one in put.unusable)
        return Put(put.present, tuple(unusable))

    async def put_files(self, files: Sequence[Path]) -> tuple[Unusable, ...]:
        """Have the service read files with times, poses and calibration as KITTI has them."""
        read = [(file.name, file.read_bytes()) for file in files]
        return (await self._put_tar(read, {})).unusable

    async def _put_tar(self, files: Sequence[tuple[str, bytes]], params: Mapping[str, str]) -> Put:
        present = 0
        try:
            answer = await self._transport.json(
                "POST",
                f"{self._drive}/scans",
                content=_tar(files),
                params=params,
                headers={"Content-Type": _TAR},
            )
            present, set_aside = answer["scans_present"], answer["set_aside"]
        except NothingStored as error:  # of these files; others of the drive may be usable
            set_aside = error.set_aside
        unusable = (
            Unusable(one["file"], one["type"].rpartition("/")[2], one["detail"])
            for one in set_aside
        )
        return Put(present, tuple(unusable))


def _pose_row(scan: ScanBody) -> str | None:
    """Return a scan's row in a table of poses, `None` if neither pose nor time is known."""
    if scan.pose is None and scan.timestamp_s is None:
        return None
    pose = [""] * 7 if scan.pose is None else map(_digits, scan.pose)
    time = "" if scan.timestamp_s is None else _digits(scan.timestamp_s)
    return ",".join([str(scan.index), *pose, time])


def _digits(number: float) -> str:
    return repr(float(number))  # of an array's number it would be "np.float64(...)"


def _tar(files: Sequence[tuple[str, bytes]]) -> bytes:
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        for name, content in files:
            member = tarfile.TarInfo(name)
            member.size = len(content)
            archive.addfile(member, io.BytesIO(content))
    return packed.getvalue()
