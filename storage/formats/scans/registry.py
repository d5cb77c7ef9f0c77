"""From the bytes of a scan file to a scan, by media type, suffix or magic."""

import math
from pathlib import Path, PurePath

from core.errors import InvalidScan
from core.scans.pose import Pose
from core.scans.scan import Scan
from storage.formats.budget import BUDGET
from storage.formats.errors import EmptyBody, UnknownFormat
from storage.formats.scans.delimited import CsvFormat
from storage.formats.scans.ford import FordFormat
from storage.formats.scans.helipr import (
    AevaEarlyFormat,
    AevaFormat,
    AviaFormat,
    HeliprOusterFormat,
    HeliprVelodyneFormat,
)
from storage.formats.scans.kitti import KittiFormat
from storage.formats.scans.las import LasFormat
from storage.formats.scans.metres import require_metres
from storage.formats.scans.npy import NpyFormat
from storage.formats.scans.ouster import OusterFormat
from storage.formats.scans.pcd import PcdFormat
from storage.formats.scans.ply import PlyFormat
from storage.formats.scans.records import NcltFormat, NuscenesFormat
from storage.formats.scans.scan_format import ScanFormat
from storage.formats.scans.velodyne import VelodyneFormat

ANY_BYTES = "application/octet-stream"
"""The media type of a body whose format is not known."""
_OF_SEVERAL = frozenset({".bin", ".pcap"})  # records without a header, captures of two makers


SCAN_FORMATS: tuple[ScanFormat, ...] = (
    KittiFormat(),
    NpyFormat(),
    PcdFormat(),
    PlyFormat(),
    CsvFormat(),
    LasFormat(),
    NuscenesFormat(),
    NcltFormat(),
    HeliprOusterFormat(),
    HeliprVelodyneFormat(),
    AviaFormat(),
    AevaFormat(),
    AevaEarlyFormat(),
    FordFormat(),
    VelodyneFormat(),
    OusterFormat(),
)
FORMAT_NAMES = {known.media_type.rpartition(".")[2]: known.media_type for known in SCAN_FORMATS}
"""Media types by their last word."""


def read_scan(
    body: bytes,
    *,
    media_type: str | None = None,
    suffix: str | None = None,
    min_returns: int,
    timestamp_s: float = math.nan,
    pose: Pose | None = None,
) -> Scan:
    """Read one scan.

    The media type decides; without one, or with `application/octet-stream`, the suffix; without a
    suffix, the magic at the beginning of the body.

    Args:
        body: The whole file.
        media_type: A Content-Type; its parameters are ignored.
        suffix: The end of the file's name, with the dot.
        min_returns: Least number of finite, non-zero returns.
        timestamp_s: Seconds, NaN where unknown.
        pose: Sensor to world, `None` where unknown.

    Raises:
        UnknownFormat: If no reader claims the bytes.
        InvalidScan: If the reader cannot use them; a subclass says why.

    Examples:
        >>> import numpy as np
        >>> body = np.array([[10, 0, -1, 0.3], [0, 0, 0, 0]], "<f4").tobytes()
        >>> scan = read_scan(body, media_type="application/vnd.tensormap.kitti", min_returns=1)
        >>> len(scan), scan.dropped_returns
        (1, 1)
    """
    scan_format = _choose(body, media_type, suffix)
    if not body:
        raise EmptyBody(f"the body is empty, wanted a {scan_format.name} scan")
    returns_m = scan_format.read(body)
    BUDGET.require_returns(len(returns_m))
    scan = Scan.from_returns(returns_m, min_returns=min_returns, timestamp_s=timestamp_s, pose=pose)
    require_metres(scan.points_m)
    return scan


def read_scan_file(
    path: str | Path,
    *,
    min_returns: int,
    media_type: str | None = None,
    timestamp_s: float = math.nan,
    pose: Pose | None = None,
) -> Scan:
    """Read one scan file, its format by its suffix; errors name the file.

    A media type decides instead where one is given, as for a `.bin` that is not KITTI's. A `.pcap`
    with a `.json` of the same name beside it is an Ouster's with its metadata, unless the media
    type is another one.

    Raises:
        UnknownFormat: If no reader claims the file.
        InvalidScan: If the reader cannot use it; a subclass says why.
    """
    path = Path(path)
    body, media_type = scan_file_body(path, media_type)
    try:
        return read_scan(
            body,
            media_type=media_type,
            min_returns=min_returns,
            timestamp_s=timestamp_s,
            pose=pose,
        )
    except (InvalidScan, UnknownFormat) as error:
        raise type(error)(f"{path.name}: {error}") from error


def scan_file_body(path: Path, media_type: str | None = None) -> tuple[bytes, str]:
    """Return a scan file's bytes and media type, as a service takes them.

    Args:
        path: The file; its metadata precede an Ouster's capture.
        media_type: The media type, in place of that of its suffix.

    Raises:
        UnknownFormat: If no reader claims the file.
    """
    metadata = path.with_suffix(".json")
    body = path.read_bytes()
    ouster = OusterFormat().media_type
    if path.suffix.lower() == ".pcap" and media_type in {None, ouster} and metadata.is_file():
        return metadata.read_bytes() + body, ouster
    try:
        return body, _choose(body, media_type, suffix_of(path.name)).media_type
    except (InvalidScan, UnknownFormat) as error:
        raise type(error)(f"{path.name}: {error}") from error


def is_scan_file(path: Path) -> bool:
    """Return whether the name has the suffix of a scan file and is not hidden."""
    ends = {suffix for scan_format in SCAN_FORMATS for suffix in scan_format.suffixes}
    return not path.name.startswith(".") and suffix_of(path.name) in ends


def media_type_of(name: str | None) -> str | None:
    """Return the media type of a format by its short name, the last word of its type.

    `None` for no name.

    Raises:
        UnknownFormat: If there is no such format.

    Examples:
        >>> media_type_of("nclt")
        'application/vnd.tensormap.nclt'
    """
    if name is None:
        return None
    if name not in FORMAT_NAMES:
        names = ", ".join(FORMAT_NAMES)
        raise UnknownFormat(f"there is no format {name[:80]!r}; wanted one of {names}")
    return FORMAT_NAMES[name]


def suffix_of(file_name: str) -> str:
    """Return the suffix of a scan file's name, with the dot, lower case."""
    # nuScenes' `.pcd.bin` is not KITTI's `.bin`: its records have five floats, and would be
    # plausible but wrong if read as four.
    name = file_name.lower()
    return ".pcd.bin" if name.endswith(".pcd.bin") else PurePath(name).suffix


def says_format(suffix: str) -> bool:
    """Return whether only files of one format have a suffix.

    Examples:
        >>> says_format(".npy"), says_format(".bin"), says_format(".xyz")
        (True, False, False)
    """
    if suffix in _OF_SEVERAL:
        return False
    return any(suffix in known.suffixes for known in SCAN_FORMATS)


def _choose(body: bytes, media_type: str | None, suffix: str | None) -> ScanFormat:
    given = (media_type or "").partition(";")[0].strip().lower()
    if given not in {"", ANY_BYTES}:
        found = [known for known in SCAN_FORMATS if known.media_type == given]
        what = f"media type {given[:80]!r}"
    elif suffix:
        found = [known for known in SCAN_FORMATS if suffix.lower() in known.suffixes]
        what = f"suffix {suffix[:80]!r}"
    elif not body:
        raise EmptyBody("the body is empty, wanted a scan")
    else:
        found = [known for known in SCAN_FORMATS if body.startswith(known.magics)]
        what = f"a body without a Content-Type that begins with {body[:8]!r}; set the Content-Type"
    if not found:
        known_types = ", ".join(
            f"{known.media_type} ({' '.join(known.suffixes) or 'no suffix'})"
            for known in SCAN_FORMATS
        )
        raise UnknownFormat(f"no reader for {what}; wanted one of {known_types}")
    return found[0]
