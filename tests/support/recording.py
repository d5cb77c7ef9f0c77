"""A short simulated drive, rendered once a session, and its request bodies."""

import functools
import io
import tarfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from app.drives.tar_stream import TarFeed, TarMember
from core.scans.pose import Pose
from core.scans.scan import Scan
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor

KITTI = {"Content-Type": "application/vnd.tensormap.kitti"}
NPY = {"Content-Type": "application/vnd.tensormap.npy"}
TAR = {"Content-Type": "application/x-tar"}

_PIECE_BYTES = 2**16


@dataclass(frozen=True)
class Recording:
    """Scans of one drive, each with its pose and time."""

    scans: tuple[Scan, ...]

    def __len__(self) -> int:
        return len(self.scans)

    def pose(self, index: int) -> Pose:
        """Return the pose of scan `index`."""
        pose = self.scans[index].pose
        assert pose is not None
        return pose


@functools.cache
def recording(*, noise_seed: int = 0, scans: int = 48) -> Recording:
    """Return a drive round a block; another noise seed passes the same places once more."""
    drive = SimulatedDrive(
        seed=1,
        scans=48,
        stops=False,
        noise_seed=noise_seed,
        sensor=SimulatedSensor(firings=180),
    )
    poses = [Pose.from_row(row) for row in drive.poses]
    rendered = (drive.scan(index) for index in range(scans))
    return Recording(
        tuple(
            Scan(scan.points_m, float(time_s), pose)
            for scan, time_s, pose in zip(rendered, drive.timestamp_s, poses, strict=False)
        )
    )


def far_away() -> np.ndarray:
    """Return a scan that no map can use: every return is beyond the rings."""
    return recording().scans[0].points_m[:200] * 0.0 + [500.0, 0.0, 0.0]


def kitti(scan: Scan) -> bytes:
    """Return a scan as KITTI's records, without reflectance."""
    return np.pad(scan.points_m, ((0, 0), (0, 1))).astype("<f4").tobytes()


def npy(array: np.ndarray) -> bytes:
    """Return an array as a NumPy file."""
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def upload_scan(client, slug: str, drive: str, index: int, scan: Scan, **options: Any) -> Any:
    """Put one scan as KITTI sends it."""
    return client.put(
        f"/v1/maps/{slug}/drives/{drive}/scans/{index}",
        content=kitti(scan),
        headers=KITTI,
        **options,
    )


def tar(files: Iterable[tuple[str, bytes]]) -> bytes:
    """Return a tar of named contents."""
    body = io.BytesIO()
    with tarfile.open(fileobj=body, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        for name, content in files:
            member = tarfile.TarInfo(name)
            member.size = len(content)
            archive.addfile(member, io.BytesIO(content))
    return body.getvalue()


def tar_members(body: bytes, most_bytes: int) -> Iterator[TarMember]:
    """Yield the files of a tar stream as an upload reads them, 64 KiB of its body at a time."""
    feed = TarFeed(most_bytes)
    for start in range(0, len(body), _PIECE_BYTES):
        yield from feed.take(body[start : start + _PIECE_BYTES])
    yield from feed.take(b"")
