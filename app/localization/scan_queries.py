"""Queries by returns: one scan, or consecutive ones with odometry, of a sensor that is mounted."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from pathlib import PurePosixPath

import numpy as np

from app.drives.pose_files import CSV, POSE_TYPES, read_poses
from app.drives.tar_scans import member_index, member_scan
from app.drives.tar_stream import TarFeed, TarMember
from app.http.bodies.bodies import SCAN_TYPES, media_type
from app.http.client import require_client
from app.http.errors import BAD_SCAN, MalformedUpload
from app.localization.sensor_schemas import SensorIn
from app.settings import Settings
from core.arrays import FloatArray
from core.errors import InvalidParameters, InvalidPose, InvalidScan, TooFewReturns
from core.scans.accumulation import MOST_SCANS, accumulate, require_few_returns
from core.scans.mounting import Mounting
from core.scans.scan import Scan
from core.scans.tilt import Tilt
from core.text import count_of
from storage.formats.errors import EmptyBody, UnknownFormat
from storage.formats.scans.registry import ANY_BYTES, media_type_of, read_scan

TAR = "application/x-tar"
BAD_SCAN_QUERY = (*BAD_SCAN, InvalidPose, InvalidParameters, MalformedUpload)
"""Errors of every route that takes a query by returns."""
_POSES = {f"poses.{kind.rpartition('.')[2]}": kind for kind in POSE_TYPES}
_WANTED = "wanted one of " + ", ".join(_POSES)
SCAN_QUERY_TYPES = {
    **SCAN_TYPES,
    TAR: f"Up to {MOST_SCANS} consecutive scans that become one, in the frame of the last: files"
    " named by their index, as `000012.pcd`, and the vehicle's odometry, one of "
    + ", ".join(_POSES),
}


def read_query(
    body: bytes,
    content_type: str | None,
    sensor: SensorIn,
    settings: Settings,
    sensor_height_m: float,
) -> Scan:
    """Return the scan of a query in the vehicle's frame, level where its tilt is known.

    Args:
        body: A scan file, or a tar of several with the vehicle's odometry.
        content_type: The body's content type.
        sensor: The query's sensor.
        settings: The settings, of which `min_returns` applies to the whole query.
        sensor_height_m: The map's sensor height.

    Raises:
        TooFewReturns: If no return is left in the vehicle's frame; otherwise as
            `read_sensor_scan`.
    """
    return read_sensor_scan(body, content_type, sensor, settings).above(sensor_height_m)


@dataclass(frozen=True, eq=False)
class SensorScan:
    """The scan of a query as its sensor has it, read once for maps of several sensor heights.

    Attributes:
        scan: The returns in the sensor's frame.
        mounting: The sensor's mounting, `None` if the vehicle's frame is the sensor's.
        tilt: The vehicle's tilt against gravity, `None` if it is not known.
    """

    scan: Scan
    mounting: Mounting | None
    tilt: Tilt | None

    def above(self, sensor_height_m: float) -> Scan:
        """Return the scan in the vehicle's frame, level where its tilt is known.

        Args:
            sensor_height_m: The map's sensor height; without a mounting nothing depends on it.

        Raises:
            TooFewReturns: If no return is left.
        """
        if self.mounting is None:
            return self._level
        return _levelled(self.mounting.mount(self.scan, sensor_height_m), self.tilt)

    @cached_property
    def _level(self) -> Scan:
        return _levelled(self.scan, self.tilt)


def _levelled(scan: Scan, tilt: Tilt | None) -> Scan:
    return scan if tilt is None else tilt.level(scan)


def read_sensor_scan(
    body: bytes, content_type: str | None, sensor: SensorIn, settings: Settings
) -> SensorScan:
    """Return the scan of a query.

    Args:
        body: A scan file, or a tar of several with the vehicle's odometry.
        content_type: The body's content type.
        sensor: The query's sensor.
        settings: The settings, of which `min_returns` applies to the whole query.

    Raises:
        InvalidScan: If the scans cannot be used, or cannot become one.
        InvalidPose: If the odometry cannot be used, or does not fit the scans.
        InvalidParameters: If the mounting or the tilt cannot be used, or the format is not that of
            the content type.
        EmptyBody: If there is no body.
        UnknownFormat: If a scan is of no known format.
        MalformedUpload: If several are no tar, or one that breaks off.
    """
    mounting, tilt = sensor.to_mounting(), sensor.to_tilt()
    kind = media_type(content_type)
    if kind == TAR:
        scans, poses = _read_tar(body, sensor.format_name, settings)
        scan = accumulate(scans, poses if mounting is None else mounting.sensor_poses(poses))
        if len(scan) < settings.min_returns:
            raise TooFewReturns(
                f"{len(scan)} returns of {count_of(len(scans), 'scan')} are finite and"
                f" non-zero, at least {settings.min_returns} are wanted"
            )
    else:
        named = media_type_of(sensor.format_name)
        if named is not None and kind not in {"", ANY_BYTES, named}:
            raise InvalidParameters(
                f"format is {sensor.format_name}, the Content-Type is {kind[:80]}: wanted one of"
                " them, or the same in both"
            )
        scan = read_scan(body, media_type=named or kind, min_returns=settings.min_returns)
    return SensorScan(scan, mounting, tilt)


def _read_tar(
    body: bytes, format_name: str | None, settings: Settings
) -> tuple[list[Scan], FloatArray]:
    """Return scans in the order of their indices, and the vehicle's `(n, 7)` pose rows."""
    if not body:
        raise EmptyBody("the body is empty, wanted a tar of scans and their poses")
    scan_type = media_type_of(format_name)
    scans: dict[int, Scan] = {}
    poses: dict[str, bytes] = {}
    returns = 0
    for member in _members(body, settings):
        require_client()
        name = PurePosixPath(member.name).name
        if name in _POSES:
            if name in poses:
                raise InvalidPose(f"{name} comes twice in the tar")
            if isinstance(member.content, InvalidScan):
                raise InvalidPose(f"{name} of the tar: {member.content}")
            poses[name] = member.content
            continue
        if len(scans) == MOST_SCANS:
            raise InvalidScan(f"the tar has more than {MOST_SCANS} scans, which cannot become one")
        try:
            index = member_index(member)
            scan = member_scan(member, scan_type, min_returns=1)
        except (InvalidScan, UnknownFormat) as error:
            raise type(error)(f"{member.name[:80]}: {error}") from error
        if index in scans:
            raise InvalidScan(f"scan {index} comes twice in the tar")
        scans[index] = scan
        returns += len(scan) + scan.dropped_returns  # these take as long to read
        require_few_returns(returns)
    if not scans:
        raise MalformedUpload("the tar has no file, wanted scans named by their index")
    if len(poses) != 1:
        found = " and ".join(sorted(poses)) or "none"
        raise InvalidPose(f"{_WANTED}, got {found} in the tar")
    [(name, content)] = poses.items()
    return [scans[index] for index in sorted(scans)], _rows(name, content, sorted(scans))


def _members(body: bytes, settings: Settings) -> Iterator[TarMember]:
    feed = TarFeed(settings.max_body_bytes)
    return chain(feed.take(body), feed.take(b""))


def _rows(name: str, content: bytes, scans: list[int]) -> FloatArray:
    """Return the pose rows of scans: those of a CSV name them, other lines are in their order."""
    found = read_poses(content, _POSES[name])
    if _POSES[name] != CSV:
        if len(found) != len(scans):
            lines = count_of(len(found), "line")
            raise InvalidPose(f"{name} has {lines}, wanted one of each of {len(scans)}")
        return found.poses
    missing = np.setdiff1d(scans, found.scans)
    if len(missing):
        raise InvalidPose(f"{name} has no line of scan {missing[0]}")
    return np.asarray(found.poses[np.searchsorted(found.scans, scans)])
