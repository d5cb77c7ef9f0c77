"""The service's answers; fields that a newer service adds are in `raw` only."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Self

from tensormap_client.errors import Unreachable

Answer = Mapping[str, Any]
"""An answer of the service as JSON; docs/reference/http-api.md names its fields."""


class JsonObject(dict[str, Any]):
    """The fields of an answer; a missing one raises `Unreachable`: another service answered.

    Args:
        request: The request that was answered, for the message.
        fields: The fields as received.
    """

    def __init__(self, request: str, fields: Mapping[str, Any]) -> None:
        super().__init__(fields)
        self._request = request

    @classmethod
    def of_message(cls, stream: str, message: str | bytes) -> Self:
        """Return the fields of a stream's message.

        Raises:
            Unreachable: If it has none: another service answered.
        """
        try:
            return cls(f"stream {stream}", json.loads(message))
        except (ValueError, TypeError) as error:
            raise Unreachable(
                f"there is no TensorMap service: stream {stream} was answered by no object"
            ) from error

    def part(self, fields: Mapping[str, Any]) -> "JsonObject":
        """Return the fields of an object within this one."""
        return JsonObject(self._request, fields)

    def __missing__(self, name: str) -> Any:  # noqa: ANN401 - of a field
        raise Unreachable(
            f"there is no TensorMap service: {self._request} was answered without {name!r}"
        )


@dataclass(frozen=True)
class Pose:
    """Metres in the map's frame, a unit quaternion, and the heading counter-clockwise from x."""

    x_m: float
    y_m: float
    z_m: float
    qx: float
    qy: float
    qz: float
    qw: float
    yaw_deg: float

    @classmethod
    def from_json(cls, answer: Mapping[str, Any] | None) -> Self | None:
        """Read a pose; `None` from a map without poses."""
        return None if answer is None else cls(**_of(cls, answer))


@dataclass(frozen=True)
class Match:
    """A scan of the map, and where the query is relative to it; unknown fields are `None`."""

    segment: int
    fraction: float
    along_m: float | None
    drive: str
    scan_index: int
    distance: float
    turn_deg: float | None
    lateral_m: float | None
    heading_deg: float | None
    pose: Pose | None
    estimated_pose: Pose | None

    @classmethod
    def from_json(cls, answer: Mapping[str, Any]) -> Self:
        """Read a match."""
        poses = {name: Pose.from_json(answer[name]) for name in ("pose", "estimated_pose")}
        return cls(**(_of(cls, answer) | poses))


@dataclass(frozen=True)
class Localization:
    """Where a scan was recorded; `best` is the answer only if `localized`.

    Attributes:
        revision: The revision that answered.
        live_revision: The revision that is live now.
        localized: Whether the best match is accepted.
        reason: Why the best match is not accepted; `None` if it is.
        probability: Probability that the best match is right; `None` from a map without
            calibration.
        best: The nearest scan.
        matches: The k nearest scans.
        raw: The answer as received.
    """

    revision: str
    live_revision: str
    localized: bool
    reason: str | None
    probability: float | None
    best: Match
    matches: tuple[Match, ...]
    raw: Mapping[str, Any]

    @classmethod
    def from_json(cls, answer: Mapping[str, Any]) -> Self:
        """Read an answer to a query."""
        return cls(**(_of(cls, answer) | _matches(Match, answer)))


@dataclass(frozen=True)
class MatchInMap(Match):
    """A match, with its map and that map's live revision."""

    map: str
    revision: str


@dataclass(frozen=True)
class LocalizationInMaps:
    """In which map a scan was recorded, and where; `best` is the answer only if `localized`.

    Attributes:
        map: The best match's map.
        localized: Whether the best match is accepted.
        reason: Why the best match is not accepted; `None` if it is.
        probability: Probability that the best match is right; `None` from a map without
            calibration.
        best: The nearest scan of all maps.
        matches: The k nearest scans.
        maps_searched: How many maps have the basis and were searched.
        maps_not_searched: How many other maps the key may read; `raw` says why they were not
            searched.
        raw: The answer as received.
    """

    map: str
    localized: bool
    reason: str | None
    probability: float | None
    best: MatchInMap
    matches: tuple[MatchInMap, ...]
    maps_searched: int
    maps_not_searched: int
    raw: Mapping[str, Any]

    @classmethod
    def from_json(cls, answer: Mapping[str, Any]) -> Self:
        """Read an answer to a query of all maps."""
        return cls(**(_of(cls, answer) | _matches(MatchInMap, answer)))


@dataclass(frozen=True)
class TrackAnswer:
    """The estimated place of a vehicle; it is accepted only if `localized`.

    Attributes:
        sequence: The answered observation's number.
        timestamp_s: The answered observation's time, `None` if it had none.
        revision: The track's revision.
        live_revision: The revision that is live now.
        localized: Whether the place is accepted.
        reason: Why the place is not accepted; `None` if it is.
        raw: The answer as received.
    """

    sequence: int | None
    timestamp_s: float | None
    observations: int
    revision: str
    live_revision: str | None
    localized: bool
    reason: str | None
    probability: float
    segment: int
    fraction: float
    drive: str
    scan_index: int
    standing: bool
    direction: str | None
    along_sigma_m: float | None
    turn_deg: float | None
    lateral_m: float | None
    pose: Pose | None
    raw: Mapping[str, Any]

    @classmethod
    def from_json(cls, answer: Mapping[str, Any]) -> Self:
        """Read an answer of a track."""
        read = {"pose": Pose.from_json(answer["pose"]), "raw": dict(answer)}
        return cls(**(_of(cls, answer) | read))


def _matches(kind: type[Match], answer: Mapping[str, Any]) -> dict[str, Any]:
    best, *matches = (
        kind.from_json(answer.part(match) if isinstance(answer, JsonObject) else match)
        for match in (answer["best"], *answer["matches"])
    )
    return {"best": best, "matches": tuple(matches), "raw": dict(answer)}


def _of(kind: type[Any], answer: Mapping[str, Any]) -> dict[str, Any]:
    return {field.name: answer.get(field.name) for field in fields(kind)}
