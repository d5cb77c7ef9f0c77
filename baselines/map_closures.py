"""MapClosures (Gupta et al., ICRA 2024) of the package index, as a baseline.

The package requires older versions of our dependencies, so that it is no extra of ours;
`pip install --no-deps map_closures` is enough for what is called here.
"""

import importlib
import importlib.util
import itertools
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from baselines.descriptor import enrol_each
from core.arrays import FloatArray, IntArray
from core.errors import InvalidParameters
from core.evaluation.methods import Enrolled, Match, Nearest
from core.progress import NO_PROGRESS, Progress
from core.scans.drive import Drive
from core.scans.scan import Scan

_FIRST_QUERY_ID = 1_000_001  # queries enter the detector's database too


class _Closure(Protocol):
    source_id: int
    pose: FloatArray
    number_of_inliers: int


def is_installed() -> bool:
    """Return whether the package can be imported."""
    return importlib.util.find_spec("map_closures") is not None


class MapClosures:
    """Single scans as local maps: the package is made for maps of many scans, joined by odometry.

    The detector keeps every query. Closures with other queries are left out, but they
    stay in its database, so that matching becomes slower with every query.
    """

    name = "map-closures"

    def configuration(self) -> dict[str, Any]:
        """Return the package's version and its own defaults.

        Raises:
            InvalidParameters: If it is not installed.
        """
        _require_installed()
        config = importlib.import_module("map_closures.config").MapClosuresConfig()
        return {"version": version("map_closures"), **config.model_dump()}

    def enrol(self, drive: Drive, scans: IntArray, progress: Progress = NO_PROGRESS) -> Enrolled:
        """Pass the scans to the detector one by one.

        Raises:
            EmptyDrive: If not one of them is usable.
            InvalidParameters: If the package is not installed.
        """
        _require_installed()
        detector = importlib.import_module("map_closures.map_closures").MapClosures()
        enrolled = itertools.count()

        def enrol(scan: Scan) -> None:
            detector.get_best_closure(next(enrolled), scan.points_m.astype(np.float64))

        kept = enrol_each(self.name, drive, scans, enrol, progress)
        query_ids = itertools.count(_FIRST_QUERY_ID)

        def describe(scan: Scan) -> Match:
            # The package describes and matches in one call.
            points = scan.points_m.astype(np.float64)
            return lambda before: _nearest(
                detector, next(query_ids), points, len(kept) if before is None else before
            )

        # A query is a set of features, of no fixed size.
        return Enrolled(kept, None, _database_bytes(detector) / len(kept), describe)


def _nearest(
    detector: Any,  # noqa: ANN401 - the package has no types
    query_id: int,
    points: FloatArray,
    last: int,
) -> Nearest | None:
    closures: list[_Closure] = detector.get_closures(query_id, points)
    among = [closure for closure in closures if closure.source_id < last]
    if not among:
        return None
    best = max(among, key=lambda closure: (closure.number_of_inliers, -closure.source_id))
    forward = np.asarray(best.pose)[:2, 0]  # of the place, seen from the query
    relative_yaw_deg = -float(np.degrees(np.arctan2(forward[1], forward[0])))
    return Nearest(best.source_id, 1.0 / (1.0 + best.number_of_inliers), relative_yaw_deg)


def _database_bytes(detector: Any) -> int:  # noqa: ANN401 - the package has no types
    with tempfile.TemporaryDirectory(prefix="tensormap-") as folder:
        path = Path(folder) / "database"
        detector.save_hbst_database(str(path))
        return sum(file.stat().st_size for file in Path(folder).rglob("*") if file.is_file())


def _require_installed() -> None:
    if not is_installed():
        raise InvalidParameters("map_closures is not installed: pip install --no-deps map_closures")
