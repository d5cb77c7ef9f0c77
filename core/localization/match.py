"""A match: a scan of the map, and the query's pose relative to it."""

import math
from dataclasses import dataclass

import numpy as np

from core.arrays import FloatArray, IntArray
from core.encodings.model import Neighbours, Search
from core.mapping.tensormap import TensorMap
from core.projection.probe import Displacement
from core.scans.angles import wrapped_deg
from core.scans.displacement import left_of_m, places_beside_m, pose_beside
from core.scans.pose import Pose, heading_deg, path_length_m
from core.scans.trajectory import Trajectory

_SHARPNESS = 8  # weights are the inverse distance to this power: docs/decisions/0010
_SCANS_BESIDE = 1  # before and after the match; the weights of farther ones are negligible
_SAME_PLACE_M = 10.0  # after an interruption a drive continues elsewhere
_SAME_YAW_DEG = 20.0  # a rendering with another relative yaw is similar to the query by chance


@dataclass(frozen=True)
class Match:
    """A scan of the map, and the query's pose relative to it.

    Attributes:
        segment: Its segment.
        fraction: How far along the segment, 0 at its start and 1 at its end.
        along_m: The same in metres, `None` where a pose on the way is unknown.
        drive: The drive it was recorded in.
        scan_index: Its index in that drive.
        row: Its row in the map.
        distance: Between the signatures, in the measure of the map; infinite if the query has no
            signature of the scan's segment.
        timestamp_s: When it was recorded, `None` where unknown.
        pose: Where it was recorded, `None` where unknown.
        relative_yaw_deg: Of the query, counter-clockwise, -180..180; `None` where the encoding
            does not give it, as the paper's.
        lateral_m: Lateral offset of the query, positive to the left of the scan; `None` likewise.
        estimated_pose: Of the query: `pose` displaced and turned; `None` likewise.
    """

    segment: int
    fraction: float
    along_m: float | None
    drive: str
    scan_index: int
    row: int
    distance: float
    timestamp_s: float | None
    pose: Pose | None
    relative_yaw_deg: float | None = None
    lateral_m: float | None = None
    estimated_pose: Pose | None = None

    @property
    def heading_deg(self) -> float | None:
        """Heading of the query in the world, counter-clockwise, `None` where not estimated."""
        if self.estimated_pose is None or self.relative_yaw_deg is None:
            return None
        return self.estimated_pose.yaw_deg


def match_at(tensor_map: TensorMap, search: Search, found: Neighbours, position: int = 0) -> Match:
    """Return a neighbour of a search as a match, with a sub-scan pose where there are viewpoints.

    Renderings are 1.5 m apart and scans a metre or two; the pose is the mean of the similar ones,
    weighted by (d_best / d)^8. Without poses only the matched scan's renderings are averaged. Of
    a search that compares images it is where they are most alike.

    Args:
        tensor_map: The map.
        search: The query's search.
        found: Its neighbours.
        position: Index of the neighbour.
    """
    row, distance = int(found.rows[position]), float(found.distances[position])
    trajectory = tensor_map.trajectory
    segment = int(np.searchsorted(tensor_map.model.segment_start, row, "right")) - 1
    first, last = tensor_map.segment_ends[segment].tolist()
    placed = search.displacement(row)
    if placed is None:
        yaw_deg, lateral_m, pose = _refined(
            search, trajectory, row, distance, _known(found.relative_yaw_deg[position])
        )
    else:
        _, lateral_m, yaw_deg = placed
        pose = pose_at(trajectory.poses[row], placed)
    return Match(
        segment=segment,
        fraction=(row - first) / max(1, last - first),
        along_m=_known(path_length_m(trajectory.poses[first : row + 1])),
        drive=trajectory.drives[int(np.searchsorted(trajectory.drive_start, row, "right")) - 1],
        scan_index=int(trajectory.scan_index[row]),
        row=row,
        distance=distance,
        timestamp_s=_known(trajectory.timestamp_s[row]),
        pose=Pose.from_row(trajectory.poses[row]),
        relative_yaw_deg=yaw_deg,
        lateral_m=lateral_m,
        estimated_pose=pose,
    )


def pose_at(recorded: FloatArray, placed: Displacement) -> Pose | None:
    """Return the pose so far from a recorded one, `(7,)`; of an unknown one it is unknown."""
    ahead_m, left_m, yaw_deg = placed
    return Pose.from_row(pose_beside(recorded, left_m, yaw_deg, ahead_m))


def _known(value: float) -> float | None:
    return None if math.isnan(value) else float(value)


def _refined(
    search: Search, trajectory: Trajectory, row: int, distance: float, yaw_deg: float | None
) -> tuple[float | None, float | None, Pose | None]:
    """Return relative yaw, lateral offset and pose of the query, `None` where not known."""
    poses = trajectory.poses
    known = bool(trajectory.known[row])
    rows = _rows_beside(trajectory, row) if known else np.array([row])
    seen = search.viewpoints(rows)
    if seen is None:
        return None, None, None
    if yaw_deg is None:
        aside_deg = np.zeros_like(seen.relative_yaw_deg)
    elif known:
        headings_deg = heading_deg(poses[rows]) - heading_deg(poses[[row]])
        aside_deg = wrapped_deg(seen.relative_yaw_deg + headings_deg[:, None] - yaw_deg)
    else:
        aside_deg = wrapped_deg(seen.relative_yaw_deg - yaw_deg)
    nearest = max(distance, float(np.finfo(np.float32).tiny))
    weights = (nearest / np.maximum(seen.distances, nearest)) ** _SHARPNESS
    weights *= np.abs(aside_deg) <= _SAME_YAW_DEG
    weights /= weights.sum()
    if yaw_deg is not None:
        yaw_deg += float(np.sum(weights * aside_deg))
        yaw_deg = wrapped_deg(yaw_deg)
    if not known:
        return yaw_deg, float(np.sum(weights @ seen.lateral_m)), None
    seen_from_m = places_beside_m(poses[rows], seen.lateral_m)
    estimated = pose_beside(poses[row], 0.0, yaw_deg or 0.0)
    estimated[:3] = np.einsum("kd,kdx->x", weights, seen_from_m)
    return yaw_deg, left_of_m(poses[row], estimated), Pose.from_row(estimated)


def _rows_beside(trajectory: Trajectory, row: int) -> IntArray:
    """Return the rows of a drive around `row` that were recorded near it, itself included."""
    rows = np.arange(max(0, row - _SCANS_BESIDE), min(len(trajectory), row + _SCANS_BESIDE + 1))
    apart_m = np.linalg.norm(trajectory.poses[rows, :3] - trajectory.poses[row, :3], axis=1)
    same_drive = trajectory.drive_of_scan[rows] == trajectory.drive_of_scan[row]
    near = same_drive & (apart_m <= _SAME_PLACE_M)  # an unknown distance is NaN and not near
    return np.asarray(rows[near])
