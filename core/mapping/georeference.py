"""Where the drives of a map are on the Earth."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

from core.mapping.anchor import Anchor
from core.scans.pose import Pose


@dataclass(frozen=True)
class Georeference:
    """Where the drives of a map are on the Earth, as far as that is known.

    Attributes:
        anchor: The map's anchor, `None` without one.
        aside: Its drives that lie beside the others, `TensorMap.drives_aside`: they have no place
            on the Earth.
    """

    anchor: Anchor | None
    aside: Collection[str]

    def of(self, drive: str) -> Anchor | None:
        """Return the anchor for places in a drive, `None` if it has none."""
        return None if drive in self.aside else self.anchor

    def pose(self, drive: str, pose: Pose | None) -> dict[str, Any] | None:
        """Return the plain values of a pose in a drive, likewise `with_wgs84`."""
        values = None if pose is None else {**vars(pose), "yaw_deg": pose.yaw_deg}
        return self.with_wgs84(drive, values)

    def with_wgs84(self, drive: str, pose: Mapping[str, Any] | None) -> dict[str, Any] | None:
        """Return the plain values of a pose, with those of WGS84 where they are known.

        Args:
            drive: The drive in which the pose is.
            pose: `x_m`, `y_m`, `z_m`, `yaw_deg` and others; `None` where unknown.
        """
        if pose is None:
            return None
        anchor = self.of(drive)
        if anchor is None:
            return dict(pose)
        place = (pose["x_m"], pose["y_m"], pose["z_m"], pose["yaw_deg"])
        return {**pose, "wgs84": anchor.pose_wgs84(*place)}


NOWHERE = Georeference(None, frozenset())
"""The georeference of a map without an anchor."""
