"""The C++ example makes the service's signatures of a whole recorded drive."""

import json
from pathlib import Path

import numpy as np
import pytest

from core.arrays import FloatArray
from core.encodings.signature import pack_signatures
from core.projection.angles import azimuth_steps
from core.projection.levelling import level
from core.scans.scan import Scan
from tests.support.cpp import COMPILER, WITHOUT, CppSignatures
from tests.support.recorded_drives import Drives
from tests.vectors.outcomes import FOLDER, basis_of

pytestmark = [
    pytest.mark.real_data,
    pytest.mark.skipif(COMPILER is None, reason=WITHOUT),
]
HEIGHT_M = 1.73
RINGS, RING_M, COLUMNS = 20, 4.0, 360


def test_cells_and_packed_bytes_are_those_of_the_service(drives: Drives, tmp_path: Path) -> None:
    """At most one return in 100,000 is in another cell, and then on the edge of both."""
    text = (FOLDER / "bases" / "any-views.json").read_text()
    basis, cpp = basis_of(json.loads(text)), CppSignatures(text, tmp_path)
    drive = drives.open("kitti00")
    returns, elsewhere = 0, 0
    for index in range(len(drive)):
        scan = drive.scan(index)
        level_m, cells = cpp.cells(scan.points_m, HEIGHT_M)
        levelled = level(scan, HEIGHT_M)
        assert level_m.tobytes() == levelled.points_m.tobytes(), index
        other = np.flatnonzero(cells != cells_of_service(levelled))
        assert (from_a_tie_deg(levelled.points_m[other].astype(np.longdouble)) < 1e-9).all(), index
        returns, elsewhere = returns + len(scan), elsewhere + len(other)
        if not len(other):
            packed = pack_signatures(basis.encode(basis.image(scan, HEIGHT_M)))
            assert cpp.query(scan.points_m, HEIGHT_M) == packed, index
    for height_m in (float("nan"), 0.0, 100.0):
        assert cpp.query(scan.points_m, height_m) == b""
        with pytest.raises(ValueError, match="the sensor's height is"):
            cpp.cells(scan.points_m, height_m)
    assert returns > 10_000_000
    assert elsewhere <= returns / 100_000


def cells_of_service(levelled: Scan) -> np.ndarray:
    x, y = levelled.points_m[:, :2].T.astype(np.float64)
    ring = np.floor(np.sqrt(x * x + y * y) / RING_M).astype(np.int64)
    return np.where(ring < RINGS, ring * COLUMNS + azimuth_steps(x, y, 1.0) % COLUMNS, -1)


def from_a_tie_deg(points_m: np.ndarray) -> FloatArray:
    """Return how far azimuths are from the middle between two columns."""
    deg = np.degrees(np.arctan2(points_m[:, 1], points_m[:, 0]))
    return np.asarray(np.abs(deg - np.floor(deg) - 0.5), np.float64)
