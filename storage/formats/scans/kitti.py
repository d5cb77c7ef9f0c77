"""Velodyne scans as KITTI writes them: float32 records `x y z reflectance`, no header."""

import numpy as np

from core.arrays import Float32Array
from core.scans.scan import Scan
from storage.formats.errors import WrongDtype
from storage.formats.scans.coordinates import leading_columns, require_records
from storage.formats.scans.scan_format import ScanFormat

_RECORD_BYTES = 16
_LAYOUT = "float32 little-endian x y z reflectance, 16 bytes a return, in metres"

_SMALLEST_M = 1e-6
_LARGEST_M = 1e5
# Of 813 recorded scans none has more than 0.1 %. The same scans written as doubles and read as
# floats have 33 to 39 %, since half of a double's bits are plausible as a float and some are zero;
# doubles that never were floats have 51 to 56 %, integers nearly all.
_IMPLAUSIBLE_SHARE = 0.25
# Of records of 12, 20 or 24 bytes read as 16, a third to two thirds of the fourth numbers are
# coordinates, and half of these negative.
_NEGATIVE_SHARE = 0.05
_FEW = 4  # returns that someone wrote by hand may lie on an axis


def kitti_body(scan: Scan) -> bytes:
    """Return a scan as the bytes of a KITTI file, reflectance 0."""
    records = np.zeros((len(scan), 4), dtype="<f4")
    records[:, :3] = scan.points_m
    return records.tobytes()


class KittiFormat(ScanFormat):
    """The `.bin` of KITTI's recordings; it has no magic, so it is never guessed."""

    name = "KITTI"
    media_type = "application/vnd.tensormap.kitti"
    suffixes = (".bin",)

    def read(self, body: bytes) -> Float32Array:
        """Return `(n, 3)` metres, including no-returns.

        Raises:
            TruncatedScan: If the length is not a whole number of records.
            WrongDtype: If the values cannot be metres in float32, or the records have another
                length.

        Examples:
            >>> KittiFormat().read(np.array([[10, 0, -1, 0.3]], "<f4").tobytes())
            array([[10.,  0., -1.]], dtype=float32)
        """
        require_records(body, _RECORD_BYTES, _LAYOUT)
        records = np.frombuffer(body, dtype="<f4").reshape(-1, 4)
        returns_m = leading_columns(records)
        require_plausible(returns_m, _LAYOUT)
        _require_reflectance(records[:, 3])
        _require_no_padding(records)
        return returns_m


def _require_no_padding(records: Float32Array) -> None:
    """Reject `(n, 4)` records of which every other one is a number and three zeros.

    Raises:
        WrongDtype: If it is so: these are halves of records of twice the length.
    """
    first, second = records[::2], records[1::2]
    if len(second) < _FEW or second[:_FEW, 1:].any() or second[:, 1:].any():
        return
    if min(np.count_nonzero(second[:, 0]), np.count_nonzero(first[:, 1])) >= _FEW:
        raise WrongDtype(
            "every other record is a number and three zeros: are these records of 32 bytes, as of"
            f" pcl::PointXYZI in memory (x y z 1, intensity 0 0 0)? Wanted {_LAYOUT}"
        )


def _require_reflectance(fourth: Float32Array) -> None:
    """Reject records whose fourth number is often a coordinate: they have another length.

    Raises:
        WrongDtype: If many are negative, and differ; a constant may mean that none was measured.
    """
    with np.errstate(invalid="ignore"):
        negative = fourth[fourth < 0.0]
    if len(negative) > _NEGATIVE_SHARE * len(fourth) and np.ptp(negative) > 0.0:
        raise WrongDtype(
            f"{len(negative) / len(fourth):.0%} of the records have a negative reflectance: have"
            " they another length, as nuScenes' 20 bytes (x y z intensity ring) or 12 (x y z)?"
            f" Wanted {_LAYOUT}"
        )


def require_plausible(returns_m: Float32Array, layout: str) -> None:
    """Reject `(n, 3)` coordinates that no lidar measures: numbers of another type, read as float32.

    Raises:
        WrongDtype: If too many are tiny, huge or not finite; the message has the expected `layout`.
    """
    with np.errstate(invalid="ignore"):  # a signalling NaN is a NaN
        size_m = np.abs(returns_m)
        measured = np.count_nonzero((size_m >= _SMALLEST_M) & (size_m <= _LARGEST_M))
    if measured >= (1.0 - _IMPLAUSIBLE_SHARE) * np.count_nonzero(size_m):
        return  # nearly every scan; no-returns need not be counted for that
    # A return that is zero or not finite in all three is a no-return, which some drivers write, and
    # does not show the type. One that is not finite in some coordinates only does.
    counted = np.count_nonzero(size_m[np.isfinite(size_m).any(axis=1)])
    share = 1.0 - measured / counted if counted else 0.0
    if share > _IMPLAUSIBLE_SHARE:
        raise WrongDtype(
            f"{share:.0%} of the coordinates are under {_SMALLEST_M:g} m, over"
            f" {_LARGEST_M:g} m or not numbers: is this float64 or"
            f" integers, or in a map's coordinates? Wanted {layout}"
        )
