"""Drives in the layout of HeLiPR: `LiDAR/<Sensor>/<ns>.bin` and `LiDAR_GT/<Sensor>_gt.txt`.

Jung, Yang, Lee, Gil, Kim and Kim, "HeLiPR: heterogeneous LiDAR dataset for inter-LiDAR place
recognition", IJRR 43 (2024). A sequence has four sensors: Avia, Aeva, Ouster and Velodyne, each
with records of its own and a ground truth of the sensor itself: nanoseconds since 1970, x, y, z,
qx, qy, qz, qw, separated by blanks.
"""

from pathlib import Path

from storage.formats.drives.file_drive import FileDrive, in_order
from storage.formats.drives.text_rows import TUM_COLUMNS
from storage.formats.drives.timed_poses import TimedPoses, open_stamped_drive, read_timed_poses
from storage.formats.errors import MalformedDrive
from storage.formats.scans.helipr import HELIPR_FORMATS, AevaEarlyFormat

SCANS, TRUTH = "LiDAR", "LiDAR_GT"
_LAST_AEVA_WITHOUT_INTENSITY_NS = 1691936557946849179
"""From the data set's own file player: later Aeva records end with the intensity."""


def sensor_of(path: Path) -> str | None:
    """Return the sensor if a path is the folder of one, `LiDAR/<Sensor>`."""
    path = path.resolve()
    return path.name if path.parent.name == SCANS and path.name in HELIPR_FORMATS else None


def open_helipr_drive(path: Path, *, min_returns: int = 1) -> FileDrive:
    """Open the scans of one sensor; the ground truth is optional.

    Args:
        path: `<sequence>/LiDAR/<Sensor>`, or `<sequence>` if it has one sensor only.
        min_returns: Least number of returns of a scan.

    Raises:
        EmptyDrive: If there are no scans.
        MalformedDrive: If there are several sensors or none, a scan is not named by its time, or
            the poses do not parse or are of another drive.
    """
    path = path.resolve()
    sensor = sensor_of(path)
    sequence = path if sensor is None else path.parents[1]
    if sensor is None:
        found = [name for name in HELIPR_FORMATS if (sequence / SCANS / name).is_dir()]
        if len(found) != 1:
            raise MalformedDrive(
                f"{sequence / SCANS} has {', '.join(found) or 'no sensor'}, wanted the folder of"
                f" one of {', '.join(HELIPR_FORMATS)}, as {sequence.name}/{SCANS}/Ouster"
            )
        sensor = found[0]
    folder, file = sequence / SCANS / sensor, sequence / TRUTH / f"{sensor}_gt.txt"
    poses = None
    if file.exists():
        time_s, rows = read_timed_poses(file, columns=TUM_COLUMNS, ticks_per_s=1e9)
        poses = TimedPoses(file.name, time_s, rows)
    return open_stamped_drive(
        f"{sequence.name}-{sensor}",
        folder,
        poses,
        min_returns=min_returns,
        media_type=_media_type(sensor, folder),
    )


def _media_type(sensor: str, folder: Path) -> str:
    names = (file.stem for file in in_order(folder.glob("[!.]*.bin")))
    first_ns = next((int(name) for name in names if name.isdecimal()), 0)
    if sensor == "Aeva" and first_ns <= _LAST_AEVA_WITHOUT_INTENSITY_NS:
        return AevaEarlyFormat.media_type
    return HELIPR_FORMATS[sensor].media_type
