"""Points `(n, 3)` as files of each scan format."""

from io import BytesIO

import laspy
import numpy as np
from pypcd4.pypcd4 import Encoding, PointCloud
from scipy.io import savemat


def kitti(points: np.ndarray) -> bytes:
    return np.column_stack([points, np.zeros(len(points))]).astype("<f4").tobytes()


def npy(points: np.ndarray) -> bytes:
    file = BytesIO()
    np.save(file, points)
    return file.getvalue()


def pcd(points: np.ndarray, encoding: Encoding) -> bytes:
    file = BytesIO()
    PointCloud.from_xyz_points(points).save(file, encoding)
    return file.getvalue()


def nuscenes(points: np.ndarray) -> bytes:
    rings = np.arange(len(points)) % 32
    return np.column_stack([points, np.zeros(len(points)), rings]).astype("<f4").tobytes()


def ply(points: np.ndarray, order: str) -> bytes:
    encoding = {"<": "binary_little_endian", ">": "binary_big_endian", "": "ascii"}[order]
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    head = f"ply\nformat {encoding} 1.0\nelement vertex {len(points)}\n{axes}end_header\n"
    return head.encode() + (points.astype(f"{order}f4").tobytes() if order else b"")


def ply_ascii(points: np.ndarray) -> bytes:
    return ply(points, "") + b"".join(b"%r %r %r\n" % tuple(row) for row in points.tolist())


def csv(points: np.ndarray) -> bytes:
    return b"x,y,z\n" + b"".join(b"%r,%r,%r\n" % tuple(row) for row in points.tolist())


def ford(points: np.ndarray, *, compress: bool) -> bytes:
    file = BytesIO()
    scan = {"timestamp_laser": 5e5, "XYZ": points.T.astype(np.float64), "X_wv": np.zeros((6, 1))}
    # SciPy writes to open files too, its stubs do not know.
    variables = {"other": np.eye(2), "SCAN": scan}
    savemat(file, variables, do_compression=compress)  # type: ignore[arg-type]
    return file.getvalue()


def las(points: np.ndarray) -> bytes:
    header = laspy.LasHeader(point_format=0, version="1.2")
    header.scales = np.full(3, 1e-4)
    data = laspy.LasData(header)
    data.x, data.y, data.z = points.T.astype(np.float64)
    file = BytesIO()
    data.write(file, do_compress=False)
    return file.getvalue()
