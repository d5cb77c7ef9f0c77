"""What a vehicle knows of its place before the search."""

from collections.abc import Iterable
from typing import TypedDict


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


def require_known(given: Iterable[str]) -> None:
    """Raise `TypeError` for a name that is not a field of `Prior`, before anything is sent."""
    odd = [name for name in given if name not in Prior.__annotations__]
    if odd:
        raise TypeError(
            f"locate() has no argument {odd[0]!r}, wanted k, tilt, min_probability or of a prior:"
            f" {', '.join(Prior.__annotations__)}"
        )
