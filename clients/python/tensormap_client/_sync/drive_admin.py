# Made by make_sync.py: change _async instead.
"""Drives with their poses and captures, as an administrator uses them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tensormap_client._sync.drive_requests import DriveRequests
from tensormap_client._sync.session import Session
from tensormap_client.answers import Answer
from tensormap_client.io_sync import computed
from tensormap_client.paths import capture_path, drive_path, map_path
from tensormap_client.signature.basis import Mounting, require_sensor

PoseFormat = Literal["kitti", "tum", "csv"]


class DriveAdmin(Session):
    """Administers drives; `Admin` says what is raised."""

    def drives(self, map_slug: str) -> Iterator[Answer]:
        """Yield a map's drives by name."""
        return self._pages(f"{map_path(map_slug)}/drives")

    def drive(self, map_slug: str, drive_slug: str) -> Answer:
        """Return a drive: its number of scans, which are missing, its mounting, and more."""
        return self._get(drive_path(map_slug, drive_slug))

    def set_mounting(
        self, map_slug: str, drive_slug: str, mounting: Mounting | None, accumulate: int = 1
    ) -> Answer:
        """Set how builds read a drive, and return the drive; a new one is created.

        Args:
            map_slug: The map.
            drive_slug: The drive.
            mounting: The sensor's place in the vehicle, whose poses are then the map's; `None` for
                the sensor's own poses.
            accumulate: How many consecutive scans become one of a map; it is set with the mounting.
        """
        require_sensor(None, mounting)
        placed = None if mounting is None else asdict(mounting)
        wanted = {"mounting": placed, "accumulate": accumulate}
        return self._sent("PUT", drive_path(map_slug, drive_slug), wanted)

    def close_drive(self, map_slug: str, drive_slug: str) -> Answer:
        """Close a drive, and return it: it takes no new scans from then, and its files are packed.

        It stays closed.
        """
        return self._sent("PATCH", drive_path(map_slug, drive_slug), {"closed": True})

    def delete_drive(self, map_slug: str, drive_slug: str, *, purge: bool = False) -> None:
        """Delete a drive and its scans, into the recycle bin.

        Args:
            map_slug: The map.
            drive_slug: The drive.
            purge: Whether to remove it for good; that needs the scope `admin`.
        """
        self._deleted(drive_path(map_slug, drive_slug), purge=purge)

    def returns_m(self, map_slug: str, drive_slug: str, index: int) -> NDArray[np.float32] | None:
        """Return the returns of a stored scan, `(n, 3)`; `None` if the service kept none."""
        return DriveRequests(self._transport, map_slug, drive_slug).returns_m(index)

    def poses(self, map_slug: str, drive_slug: str) -> Iterator[Answer]:
        """Yield `scan`, `pose` and `timestamp_s` of each stored scan, as `put_poses` takes them."""
        path = f"{drive_path(map_slug, drive_slug)}/poses"
        return self._pages(path, items="poses", after="first")

    def put_poses(
        self, map_slug: str, drive_slug: str, poses: Sequence[Mapping[str, Any]]
    ) -> Answer:
        """Set poses and times of stored scans, all or none, and return the drive.

        Args:
            map_slug: The map.
            drive_slug: The drive.
            poses: At most 10,000, each with `scan`, and `pose` (x, y, z, qx, qy, qz, qw: sensor to
                world; `None` removes it), `timestamp_s` or both.
        """
        wanted = {"poses": [dict(one) for one in poses]}
        return self._sent("PUT", f"{drive_path(map_slug, drive_slug)}/poses", wanted)

    def put_pose_file(
        self,
        map_slug: str,
        drive_slug: str,
        file: Path | str,
        format_name: PoseFormat,
        *,
        first: int = 0,
        partial: bool = False,
    ) -> Answer:
        """Set the poses that a file has, also for scans to come, and return the drive.

        Args:
            map_slug: The map.
            drive_slug: The drive.
            file: The file, of at most 72,000 lines.
            format_name: The file's format: `kitti`, `tum` or `csv`.
            first: The scan of the first line, of `kitti` and `tum`.
            partial: Whether the file may have the poses of a part of the drive only.

        Raises:
            OSError: If the file cannot be read.
        """
        path = f"{drive_path(map_slug, drive_slug)}/poses"
        answer = self._transport.json(
            "PUT",
            path,
            content=computed(Path(file).read_bytes),
            params={"first": first} | ({"partial": "true"} if partial else {}),
            headers={"Content-Type": f"application/vnd.tensormap.poses.{format_name}"},
        )
        return dict(answer)

    def captures(self, map_slug: str, drive_slug: str | None = None) -> Iterator[Answer]:
        """Yield the uploaded captures of a map, or of one drive of it, newest first."""
        owner = map_path(map_slug) if drive_slug is None else drive_path(map_slug, drive_slug)
        return self._pages(f"{owner}/captures")

    def capture(self, map_slug: str, drive_slug: str, capture: str) -> Answer:
        """Return a capture: which of its parts are stored, and what became of it."""
        return self._get(capture_path(map_slug, drive_slug, capture))

    def delete_capture(self, map_slug: str, drive_slug: str, capture: str) -> None:
        """Delete a capture with its parts, and cancel its job; stored scans stay."""
        self._deleted(capture_path(map_slug, drive_slug, capture))
