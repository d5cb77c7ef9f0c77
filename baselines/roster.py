"""The methods that can be compared, by name."""

from collections.abc import Callable, Sequence
from functools import partial

from baselines.m2dp import M2dp
from baselines.map_closures import MapClosures, is_installed
from baselines.scan_context import ScanContext
from baselines.solid import PROFILES, Solid
from core.encodings.registry import encoding_named, encoding_names
from core.errors import InvalidParameters
from core.evaluation.methods import MappedPlaces, Method
from core.parameters import MapParameters
from core.projection.imager import Views
from core.scans.sensor import sensor_named

METHODS = (
    *encoding_names(),
    "scan-context",
    "scan-context-ring-key",
    "solid",
    "m2dp",
    "map-closures",
)
_MASKED = tuple(name for name in encoding_names() if encoding_named(name).masks)
BY_SCAN = tuple(f"{name}-scan" for name in _MASKED)
"""Queries by whole scans, of maps of any views."""
_SCAN_CONTEXT_CANDIDATES = 10  # the fewer of the paper's two, 10 and 50


def default_methods(views: Views | None = None) -> tuple[str, ...]:
    """Return all methods; `map-closures` only where its package is installed.

    Args:
        views: Which ones our maps answer: of `any`, queries by whole scans too.
    """
    installed = METHODS if is_installed() else METHODS[:-1]
    return (*BY_SCAN, *installed) if views == Views.ANY else installed


def methods_named(
    names: Sequence[str],
    *,
    sensor: str,
    sensor_height_m: float,
    segment_length: int,
    ranks: tuple[int, int] | None = None,
    views: Views | None = None,
) -> tuple[Method, ...]:
    """Return the methods of these names, each with its defaults for this sensor.

    Args:
        names: The methods' names.
        sensor: The sensor that recorded the drives.
        sensor_height_m: The sensor's height above ground.
        segment_length: k of our maps.
        ranks: `(r1, r2)` of our signatures; those of the encoding if `None`.
        views: Which ones our maps answer, in encodings that can answer them; their default if
            `None`.

    Raises:
        InvalidParameters: If a name is unknown, the sensor is, or a package is not installed; or
            if queries are whole scans and views are `full`.
    """
    grid = sensor_named(sensor).grid

    def mapped(encoding: str, *, by_scan: bool = False) -> Method:
        if by_scan and views == Views.FULL:
            raise InvalidParameters(
                f"the method {encoding}-scan wants views any; of other maps it is {encoding}"
            )
        parameters = MapParameters.for_sensor(
            sensor,
            encoding=encoding,
            ranks=ranks,
            sensor_height_m=sensor_height_m,
            views=views if encoding_named(encoding).masks else None,
        )
        return MappedPlaces(parameters, segment_length, by_scan)

    def solid() -> Method:
        lowest_deg, highest_deg = grid.elevations_deg[[0, -1]].tolist()
        half_step_deg = grid.elevation_step_deg / 2.0
        if sensor in PROFILES:
            return Solid(**PROFILES[sensor])
        return Solid(
            elevation_min_deg=max(-90.0, lowest_deg - half_step_deg),
            elevation_max_deg=min(90.0, highest_deg + half_step_deg),
        )

    context = partial(ScanContext, sensor_height_m=sensor_height_m)
    made: dict[str, Callable[[], Method]] = {
        **{name: partial(mapped, name) for name in encoding_names()},
        **{f"{name}-scan": partial(mapped, name, by_scan=True) for name in _MASKED},
        "scan-context": context,
        "scan-context-ring-key": partial(context, candidates=_SCAN_CONTEXT_CANDIDATES),
        "solid": solid,
        "m2dp": M2dp,
        "map-closures": MapClosures,
    }
    unknown = [name for name in names if name not in made]
    if unknown:
        raise InvalidParameters(
            f"there is no method {unknown[0]!r}; known are {', '.join((*METHODS, *BY_SCAN))}"
        )
    chosen = tuple(made[name]() for name in names)
    for method in chosen:
        method.configuration()  # raises before any work if a package is missing
    return chosen
