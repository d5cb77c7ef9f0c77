"""Scans as plain records without a header: nuScenes and the North Campus recordings (NCLT).

Like KITTI's they have no magic, so none is ever guessed: the Content-Type decides.
"""

import numpy as np

from core.arrays import Float32Array
from storage.formats.errors import WrongDtype
from storage.formats.scans.coordinates import leading_columns, require_records
from storage.formats.scans.kitti import require_plausible
from storage.formats.scans.scan_format import ScanFormat

_NUSCENES_BYTES = 20
_NUSCENES = "float32 little-endian x y z intensity ring, 20 bytes a return, in metres"
_MOST_RINGS = 256
_BLOCK_RECORDS = 2**18
_NCLT_RECORD = np.dtype([("xyz", "<u2", 3), ("intensity", "u1"), ("laser", "u1")])
_NCLT = "uint16 x y z, uint8 intensity and laser, 8 bytes a return"
_NCLT_STEP_M, _NCLT_FIRST_M, _NCLT_LASERS = 0.005, -100.0, 32
# Where the lidar is in the vehicle's frame, the frame of the points: 0.957 m above its origin.
# Seen from there each laser's elevation varies by 0.1 degrees, seen from the origin by 1 to 7.
NCLT_LIDAR_M = np.array([0.002, -0.004, -0.957])


class NuscenesFormat(ScanFormat):
    """The `.pcd.bin` of nuScenes; its x axis points to the right, and is kept."""

    name = "nuScenes"
    media_type = "application/vnd.tensormap.nuscenes"
    suffixes = (".pcd.bin",)

    def read(self, body: bytes) -> Float32Array:
        """Return `(n, 3)` metres.

        Raises:
            TruncatedScan: If the length is not a whole number of records.
            WrongDtype: If the values cannot be metres, or the fifth is no ring.

        Examples:
            >>> NuscenesFormat().read(np.array([[10, 0, -1, 7, 3]], "<f4").tobytes())
            array([[10.,  0., -1.]], dtype=float32)
        """
        require_records(body, _NUSCENES_BYTES, _NUSCENES)
        records = np.frombuffer(body, dtype="<f4").reshape(-1, 5)
        rings = records[:, 4]
        with np.errstate(invalid="ignore"):
            is_ring = (rings >= 0) & (rings < _MOST_RINGS) & (rings == np.floor(rings))
        if not is_ring.all():
            raise WrongDtype(
                f"{np.count_nonzero(~is_ring)} of {len(rings)} records have no ring as their fifth"
                f" number; wanted {_NUSCENES}"
            )
        returns_m = leading_columns(records)
        require_plausible(returns_m, _NUSCENES)
        return returns_m


class NcltFormat(ScanFormat):
    """The `velodyne_sync` files of NCLT; `.bin` too, so that only a Content-Type selects them.

    The file's points are in the vehicle's frame, x forward, y right, z down, on the ground below
    the lidar. Here they are rotated to y left and z up, and translated to the lidar.
    """

    name = "NCLT"
    media_type = "application/vnd.tensormap.nclt"

    def read(self, body: bytes) -> Float32Array:
        """Return `(n, 3)` metres in the lidar's frame.

        Raises:
            TruncatedScan: If the length is not a whole number of records.
            WrongDtype: If a record names a laser that the sensor does not have.

        Examples:
            >>> record = np.array([((22000, 20000, 20000), 9, 3)], _NCLT_RECORD)
            >>> NcltFormat().read(record.tobytes()).tolist()[0]  # forward, left, up
            [9.99..., -0.00..., -0.95...]
        """
        require_records(body, _NCLT_RECORD.itemsize, _NCLT)
        records = np.frombuffer(body, dtype=_NCLT_RECORD)
        unknown = np.count_nonzero(records["laser"] >= _NCLT_LASERS)
        if unknown:
            raise WrongDtype(
                f"{unknown} of {len(records)} records name a laser beyond {_NCLT_LASERS - 1};"
                f" wanted {_NCLT}"
            )
        returns_m = np.empty((len(records), 3), np.float32)
        for start in range(0, len(records), _BLOCK_RECORDS):  # doubles take six times the file
            part = slice(start, start + _BLOCK_RECORDS)
            on_vehicle_m = records["xyz"][part] * _NCLT_STEP_M + _NCLT_FIRST_M
            returns_m[part] = (on_vehicle_m - NCLT_LIDAR_M) * [1.0, -1.0, -1.0]
        return returns_m
