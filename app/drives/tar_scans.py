"""Scan files in a tar stream: the index or time that is a file's name, and the scan in it."""

import math
import re
from pathlib import PurePosixPath

from app.drives.kitti_files import SCANS
from app.drives.tar_stream import TarMember
from core.errors import InvalidScan
from core.scans.scan import Scan
from storage.formats.errors import UnknownFormat
from storage.formats.scans.file_names import time_s_of
from storage.formats.scans.kitti import KittiFormat
from storage.formats.scans.registry import read_scan, says_format, suffix_of
from storage.store.put_scans import MOST_SCANS

_NAME = re.compile(r"(\d{1,19})\.\w+(\.\w+)?", re.ASCII)
_PLAIN, _IMAGES = ".bin", frozenset({".png", ".jpg", ".jpeg"})


def member_time_s(member: TarMember) -> float | None:
    """Return the time that a file's name is, `None` if it is not a time."""
    return time_s_of(PurePosixPath(member.name).name)


def member_index(member: TarMember) -> int:
    """Return the index that a file's name is.

    Raises:
        UnknownFormat: If the name is not an index.
    """
    name = PurePosixPath(member.name).name
    found = _NAME.fullmatch(name)
    if found is None:
        raise UnknownFormat(f"the name {name[:80]!r} is no index with a suffix, as 000012.pcd")
    if int(found[1]) >= MOST_SCANS:
        raise UnknownFormat(
            f"the name {name[:80]!r} is no index, wanted less than {MOST_SCANS}, and no time: that"
            " has a fraction, or 10, 13, 16 or 19 digits since 1970"
        )
    return int(found[1])


def is_index(name: str) -> bool:
    """Return whether a file's name is an index."""
    return _NAME.fullmatch(PurePosixPath(name).name) is not None


def member_scan(
    member: TarMember, media_type: str | None, min_returns: int, time_s: float = math.nan
) -> Scan:
    """Read a file of a tar stream, its format by its suffix, or if that says none `media_type`.

    Those in a folder `velodyne` are KITTI's.

    Raises:
        UnknownFormat: If that names no format, or several.
        InvalidScan: If it cannot be used; a subclass says why.
    """
    if isinstance(member.content, InvalidScan):
        raise member.content
    suffix = suffix_of(member.name)
    if suffix in _IMAGES:
        raise UnknownFormat(f"{suffix} is an image of a camera, wanted a scan")
    if says_format(suffix):
        media_type = None
    if suffix == _PLAIN and PurePosixPath(member.name).parent.name == SCANS:
        media_type = media_type or KittiFormat.media_type
    if media_type is None and suffix == _PLAIN:
        raise UnknownFormat(
            "records in .bin may be KITTI's, nuScenes' or NCLT's; name the format, as ?format=kitti"
        )
    try:
        return read_scan(
            member.content,
            media_type=media_type,
            suffix=suffix,
            min_returns=min_returns,
            timestamp_s=time_s,
        )
    except UnknownFormat as error:
        raise UnknownFormat(
            f"no format has the suffix {suffix[:80]!r}; if it is one of another suffix, name it, as"
            " ?format=csv"
        ) from error
