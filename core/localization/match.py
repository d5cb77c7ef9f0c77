"""A match: a scan of the map, and the query's pose relative to it."""

from dataclasses import dataclass

from core.encodings.search import Neighbours, Search
from core.mapping.estimate import estimate
from core.mapping.tensormap import TensorMap
from core.numbers import none_if_nan
from core.scans.pose import Pose


@dataclass(frozen=True)
class Match:
    """A scan of the map, and the query's pose relative to it.

    Attributes:
        segment: The scan's segment.
        fraction: How far along the segment, 0 at its start and 1 at its end.
        along_m: The position in the segment in metres, `None` where a pose on the way is unknown.
        drive: The drive it was recorded in.
        scan_index: The scan's index in that drive.
        row: The scan's row in the map.
        distance: The distance between the signatures, in the map's measure; infinite if the query
            has no signature of the scan's segment.
        timestamp_s: When it was recorded, `None` where unknown.
        pose: The scan's pose, `None` where unknown.
        relative_yaw_deg: The query's relative yaw, counter-clockwise, -180..180; `None` where the
            encoding does not give it, as the paper's.
        lateral_m: Lateral offset of the query, positive to the left of the scan; `None` likewise.
        estimated_pose: The query's pose: `pose` displaced and rotated; `None` where that is
            unknown.
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


def match_at(
    tensor_map: TensorMap,
    search: Search,
    found: Neighbours,
    position: int = 0,
    seen: Search | None = None,
) -> Match:
    """Return a neighbour of a search as a match, with an estimate where there are viewpoints.

    Args:
        tensor_map: The map.
        search: The query's search.
        found: The neighbours that the search found.
        position: Index of the neighbour.
        seen: A search that knows the query's pose better; `search` without it.
    """
    row, distance = int(found.rows[position]), float(found.distances[position])
    trajectory = tensor_map.trajectory
    segment = int(tensor_map.model.segment_start.searchsorted(row, "right")) - 1
    first, last = tensor_map.segment_ends[segment].tolist()
    yaw_deg = none_if_nan(found.relative_yaw_deg[position])
    estimated = estimate(search if seen is None else seen, trajectory, row, yaw_deg)
    return Match(
        segment=segment,
        fraction=(row - first) / max(1, last - first),
        along_m=none_if_nan(trajectory.path_m(first, row)),
        drive=trajectory.drives[int(trajectory.drive_start.searchsorted(row, "right")) - 1],
        scan_index=int(trajectory.scan_index[row]),
        row=row,
        distance=distance,
        timestamp_s=none_if_nan(trajectory.timestamp_s[row]),
        pose=Pose.from_row(trajectory.poses[row]),
        relative_yaw_deg=estimated.relative_yaw_deg,
        lateral_m=estimated.lateral_m,
        estimated_pose=estimated.pose,
    )
