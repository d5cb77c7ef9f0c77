"""A pose as a query parameter."""

import math
from typing import Annotated

from fastapi import Query

from app.drives.pose_schemas import POSE_ORDER
from core.errors import InvalidPose
from core.numbers import numbers_of
from core.scans.pose import Pose

PoseQuery = Annotated[
    str | None,
    Query(description=f"Where the scan was taken, {POSE_ORDER}.", examples=["1.5,-2,1.73,0,0,0,1"]),
]


def pose_from_query(text: str | None) -> Pose | None:
    """Read `x,y,z,qx,qy,qz,qw`.

    Raises:
        InvalidPose: If it is not seven numbers with a unit quaternion.
    """
    if text is None:
        return None
    try:
        values = numbers_of(text.split(","))
    except ValueError:
        values = []
    if len(values) != 7 or not all(math.isfinite(value) for value in values):
        raise InvalidPose(f"pose is {text[:120]!r}, wanted {POSE_ORDER}")
    return Pose(*values)
