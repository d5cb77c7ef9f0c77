"""What a vehicle knows of its place before the search."""

from collections.abc import Mapping, Set
from typing import TypedDict

import numpy as np

from tensormap_client.errors import InvalidArgument


class Prior(TypedDict, total=False):
    """Query parameters of `POST .../localizations/signature`, in metres and degrees of the map.

    Each standard deviation belongs to the fields before it, and is required with them.
    """

    x_m: float
    y_m: float
    position_sigma_m: float
    heading_deg: float
    heading_sigma_deg: float
    travelled_m: float
    travelled_sigma_m: float
    since_drive: str
    since_scan: int
    since_x_m: float
    since_y_m: float
    segment: int | list[int]


def require_prior(given: Mapping[str, object]) -> None:
    """Check a prior before anything is sent.

    Raises:
        TypeError: If a name is not a field of `Prior`.
        InvalidArgument: If it names no segment at all, which would be sent as no prior, or a value
            is `None`.
    """
    odd = [name for name in given if name not in Prior.__annotations__]
    if odd:
        raise TypeError(
            f"locate() has no argument {odd[0]!r}, wanted k, tilt, min_probability or of a prior:"
            f" {', '.join(Prior.__annotations__)}"
        )
    for name, value in given.items():
        if value is None:
            raise InvalidArgument(f"{name} is None: leave out what is not known")
    segments = given.get("segment", 0)
    if np.asarray(segments).size == 0:
        raise InvalidArgument("segment is empty, wanted at least one segment")
    if isinstance(segments, Set):
        raise InvalidArgument(f"segment is the set {segments!r}, wanted a list of segments")
