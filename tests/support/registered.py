"""Scans in the frame of their poses, as SLAM exports them."""

import numpy as np
from scipy.spatial.transform import Rotation

from core.scans.scan import Scan


def registered(scan: Scan) -> Scan:
    """Return a scan whose returns are moved by its pose, which it keeps."""
    assert scan.pose is not None
    row = np.array(scan.pose.as_tuple())
    points_m = Rotation.from_quat(row[3:]).apply(scan.points_m) + row[:3]
    return Scan(points_m.astype(np.float32), scan.timestamp_s, scan.pose)
