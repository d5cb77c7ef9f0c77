"""What a query says beside its scan: what is known of the place, and how sure an answer must be."""

import inspect
from typing import Annotated, Any

from fastapi import Depends, Query

from core.errors import InvalidParameters
from core.localization.priors import HeadingHint, Hints, OdometryHint, PositionHint, ScanOfMap

_MOST_SEGMENTS = 10_000

MinProbability = Annotated[
    float | None,
    Query(
        ge=0,
        le=1,
        description="Below this probability the answer is a refusal; the map's own threshold by"
        " default, 0 to refuse nothing for its probability.",
    ),
]


def hints_of(
    x_m: Annotated[
        float | None, Query(description="Where the vehicle is about, in the map's frame.")
    ] = None,
    y_m: Annotated[float | None, Query(description="Likewise; both or none.")] = None,
    position_sigma_m: Annotated[
        float | None, Query(description="Standard deviation of both; with them.")
    ] = None,
    heading_deg: Annotated[
        float | None,
        Query(description="Which way it looks, counter-clockwise from the map's x."),
    ] = None,
    heading_sigma_deg: Annotated[
        float | None, Query(description="Its standard deviation; with it.")
    ] = None,
    travelled_m: Annotated[
        float | None, Query(description="Metres driven since the last fix.")
    ] = None,
    travelled_sigma_m: Annotated[
        float | None, Query(description="Their standard deviation, the fix's included; with them.")
    ] = None,
    since_drive: Annotated[
        str | None, Query(max_length=64, description="The last fix: the drive of its scan,")
    ] = None,
    since_scan: Annotated[
        int | None, Query(ge=0, le=2**31 - 1, description="and its `scan_index`;")
    ] = None,
    since_x_m: Annotated[
        float | None, Query(description="or where it was, in the map's frame,")
    ] = None,
    since_y_m: Annotated[float | None, Query(description="and y.")] = None,
    segment: Annotated[
        list[Annotated[int, Query(ge=0, le=2**31 - 1)]] | None,
        Query(
            max_length=_MOST_SEGMENTS,
            description="It is on this segment, or, repeated, on one of them.",
        ),
    ] = None,
) -> Hints:
    """Read hints; numbers of one hint come together.

    Raises:
        InvalidParameters: If only a part of a hint came, or a number is out of its range.
    """
    position = heading = odometry = None
    place = _together(x_m=x_m, y_m=y_m, position_sigma_m=position_sigma_m)
    if place is not None:
        position = PositionHint(*place)
    direction = _together(heading_deg=heading_deg, heading_sigma_deg=heading_sigma_deg)
    if direction is not None:
        heading = HeadingHint(*direction)
    way = _together(travelled_m=travelled_m, travelled_sigma_m=travelled_sigma_m)
    scan_of_map = (since_drive is None, since_scan is None)
    if scan_of_map[0] != scan_of_map[1]:
        raise InvalidParameters("since_drive and since_scan are one scan: give both or none")
    spot = _together(since_x_m=since_x_m, since_y_m=since_y_m)
    since = (
        spot if since_drive is None or since_scan is None else ScanOfMap(since_drive, since_scan)
    )
    if (way is None) != (since is None) or (spot is not None and since is not spot):
        raise InvalidParameters(
            "travelled_m and travelled_sigma_m want one last fix: since_drive and since_scan, or"
            " since_x_m and since_y_m"
        )
    if way is not None and since is not None:
        odometry = OdometryHint(
            since if isinstance(since, ScanOfMap) else (since[0], since[1]), *way
        )
    return Hints(position, heading, odometry, None if segment is None else tuple(segment))


def _together(**numbers: float | None) -> tuple[float, ...] | None:
    """Return the numbers of one hint, `None` if none came."""
    given = tuple(value for value in numbers.values() if value is not None)
    if given and len(given) < len(numbers):
        missing = ", ".join(name for name, value in numbers.items() if value is None)
        raise InvalidParameters(f"a hint is incomplete: {missing} is missing")
    return given or None


async def _on_the_loop(**given: Any) -> Hints:  # noqa: ANN401 - those of `hints_of`
    """Read hints where no thread is waited for: the framework would take one for each request."""
    return hints_of(**given)


_on_the_loop.__signature__ = inspect.signature(hints_of)  # type: ignore[attr-defined]

HintsIn = Annotated[Hints, Depends(_on_the_loop)]
