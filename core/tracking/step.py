"""What a track answers to one observation."""

from dataclasses import dataclass
from enum import StrEnum

from core.localization.match import Match
from core.scans.pose import Pose

SURE = 0.9
"""A place, a segment or a direction is told from this probability on."""


class Direction(StrEnum):
    """Which way a vehicle passes the scans of the map."""

    ALONG = "along"
    AGAINST = "against"


class Doubt(StrEnum):
    """Why a track does not tell where it is."""

    CONVERGING = "converging"
    UNKNOWN_PLACE = "unknown_place"
    AMBIGUOUS = "ambiguous"


@dataclass(frozen=True)
class TrackStep:
    """Where the vehicle is taken to be after an observation.

    All but `localized` and its reason is told in any case: the most likely place, sure or not.

    Attributes:
        revision: The revision that answered.
        observations: How many the track has seen, this one included.
        localized: Whether the belief is gathered in one place of the map.
        reason: Why not, `None` if it is.
        segment: The segment.
        segment_probability: Of that segment, as far as the place is right. Near a cut, and where
            the mapping vehicle itself stood at one, two segments are as likely.
        fraction: How far along it, 0 where it begins and 1 where it ends.
        position: In rows of the map, between scans too.
        match: The nearest scan to that position, and where the query was made relative to it.
        probability: Of being within 5 m of that scan, or 5 scans where poses are unknown.
        direction: Which way the vehicle passes the scans, `None` while that is not told.
        standing: Whether the vehicle stands, by its signatures alone.
        along_sigma_m: Standard deviation of the place along the path; `None` without poses.
        along_sigma_scans: The same in scans of the map.
        pose: Where the vehicle is: on the path between the scans, displaced and turned as far as
            the encoding tells; `None` without poses.
    """

    revision: str
    observations: int
    localized: bool
    reason: Doubt | None
    segment: int
    segment_probability: float
    fraction: float
    position: float
    match: Match
    probability: float
    direction: Direction | None
    standing: bool
    along_sigma_m: float | None
    along_sigma_scans: float
    pose: Pose | None

    @property
    def row(self) -> int:
        """The nearest scan's row in the map."""
        return self.match.row

    @property
    def segment_sure(self) -> bool:
        """Whether the segment is told, and not only the likelier one of two that meet there."""
        return self.localized and self.segment_probability >= SURE
