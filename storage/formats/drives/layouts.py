"""Recorded drives in any of the supported layouts."""

from collections.abc import Callable
from pathlib import Path

from core.errors import EmptyDrive
from core.scans.drive import Drive
from storage.formats.drives.captured_drive import open_captured_drive
from storage.formats.drives.ford_drive import open_ford_drive
from storage.formats.drives.helipr_drive import SCANS, open_helipr_drive, sensor_of
from storage.formats.drives.kitti_drive import open_kitti_drive, open_scan_folder
from storage.formats.drives.mulran_drive import FOLDERS, open_mulran_drive
from storage.formats.drives.nclt_drive import open_nclt_drive
from storage.formats.drives.ros_drive import is_ros_bag, open_ros_drive, split_topic
from storage.formats.errors import MalformedDrive, UnknownDriveLayout
from storage.formats.scans.registry import SCAN_FORMATS, is_scan_file

_FOLDERS: dict[str, tuple[str, Callable[..., Drive]]] = {
    "velodyne": ("KITTI", open_kitti_drive),
    "velodyne_sync": ("NCLT", open_nclt_drive),
    "SCANS": ("Ford Campus", open_ford_drive),
    **dict.fromkeys(FOLDERS, ("MulRan", open_mulran_drive)),
    SCANS: ("HeLiPR", open_helipr_drive),
}

_NAMED = 3  # folders in an error


def layout_of(path: Path) -> str:
    """Return the name of a folder's layout, such as `KITTI`; empty if it has none."""
    if path.is_dir() and sensor_of(path) is not None:
        return "HeLiPR"
    return next((name for folder, (name, _) in _FOLDERS.items() if (path / folder).is_dir()), "")


def is_drive(path: Path) -> bool:
    """Return whether a path is a folder, or a ROS bag, also with a topic: no scan file is one."""
    return path.is_dir() or is_ros_bag(split_topic(path)[0])


def is_capture(path: Path) -> bool:
    """Return whether a path is a `.pcap` of many scans: a Velodyne's, without an Ouster's metadata.

    As a scan file it is its first revolution.
    """
    is_pcap = path.suffix.lower() == ".pcap" and path.is_file()
    return is_pcap and not path.with_suffix(".json").is_file()


def open_drive(path: str | Path, *, min_returns: int = 1) -> Drive:
    """Open a recorded drive; scans are read on demand.

    Args:
        path: A folder with `velodyne/` (KITTI odometry), `velodyne_sync/` (NCLT), `SCANS/` (Ford
            Campus), `sensor_data/Ouster/` (MulRan) or `LiDAR/` (HeLiPR; also the folder of a sensor
            in it), or of scan files, in the order of their names; or a capture, `.pcap`, of which
            each full revolution is a scan; or a ROS bag, `.bag`, `.mcap`, `.db3` or a folder that
            ROS 2 recorded, with `#TOPIC` after it where several have clouds. Its name becomes the
            drive's; of KITTI's raw data, `DRIVE/velodyne_points/data`, DRIVE's does.
        min_returns: Least number of finite, non-zero returns of a scan.

    Raises:
        UnknownDriveLayout: If it is none of these.
        InvalidScan: If a capture cannot be read; a subclass says why.
        EmptyDrive: If it has a layout and no scans.
        MalformedDrive: If a file beside the scans cannot be used.
    """
    path = Path(path)
    bag, topic = split_topic(path)
    if is_ros_bag(bag):
        return open_ros_drive(bag, topic, min_returns=min_returns)
    if path.suffix.lower() == ".pcap" and path.is_file():
        return open_captured_drive(path, min_returns=min_returns)
    if path.is_dir() and sensor_of(path) is not None:
        return open_helipr_drive(path, min_returns=min_returns)
    for folder, (_, open_layout) in _FOLDERS.items():
        if (path / folder).is_dir():
            try:
                return open_layout(path, min_returns=min_returns)
            except MalformedDrive as error:  # of a file that drives of the layout all have
                raise MalformedDrive(f"{path}: {error}") from error
            except EmptyDrive as error:
                raise EmptyDrive(f"{error}{_where_scans_are(path)}") from error
    suffixes = " ".join(suffix for known in SCAN_FORMATS for suffix in known.suffixes)
    layouts = (
        "velodyne/*.bin (KITTI), velodyne_sync/*.bin (NCLT), SCANS/Scan*.mat (Ford Campus),"
        " sensor_data/Ouster/*.bin (MulRan), LiDAR/<Sensor>/*.bin (HeLiPR) or scan files"
        f" ({suffixes})"
    )
    if not path.exists():
        raise UnknownDriveLayout(f"there is no {path}; wanted a folder with {layouts}")
    if not path.is_dir():
        raise UnknownDriveLayout(
            f"{path} is no folder, no .pcap and no ROS bag; wanted a folder with {layouts}"
        )
    try:
        return open_scan_folder(path, min_returns=min_returns)
    except EmptyDrive as error:
        raise UnknownDriveLayout(f"{path} has none of {layouts}{_where_scans_are(path)}") from error


def _where_scans_are(path: Path) -> str:
    """Return which folders up to two levels below have scan files, as the end of an error."""
    folders = sorted(folder for up_to in ("*/", "*/*/") for folder in path.glob(up_to))
    found = [str(folder) for folder in folders if any(map(is_scan_file, folder.glob("*")))]
    if not found:
        return ""
    return f"; scan files are in {', '.join(found[:_NAMED])}: name one of these folders"
