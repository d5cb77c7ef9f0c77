"""The answer of a track to one observation."""

from dataclasses import dataclass
from enum import StrEnum

from core.localization.match import Match
from core.scans.pose import Pose

SURE = 0.9
"""Least probability of a place, a segment or a direction that counts as certain."""


class Direction(StrEnum):
    """Direction in which a vehicle passes the scans of the map."""

    ALONG = "along"
    AGAINST = "against"


class Doubt(StrEnum):
    """Why a track has no certain place."""

    CONVERGING = "converging"
    UNKNOWN_PLACE = "unknown_place"
    AMBIGUOUS = "ambiguous"


@dataclass(frozen=True)
class TrackStep:
    """The estimated place of the vehicle after an observation.

    The most likely place is returned in any case; `localized` is whether it is certain.

    Attributes:
        revision: The revision that answered.
        observations: How many the track has had, this one included.
        localized: Whether one place has most of the belief, and no late observation contradicts it.
        reason: Why not, `None` if it is.
        segment: The segment; of several that were cut while the mapping vehicle stood, the last.
        segment_probability: The probability of that segment among those of its drive, if the place
            is right. Near a cut two segments may be equally likely. Segments of other drives in the
            same street do not lower it.
        fraction: The position within it, 0 at its start and 1 at its end.
        position: The position in rows of the map, between scans too: the mean of the belief and of
            the estimated pose, which counts the more the farther apart scans are.
        match: The nearest scan to that position, and the query's pose relative to it.
        probability: The probability of being within 5 m of that scan, or within the distance to
            the scans beside it where these are farther, up to 10 m; within five strides where poses
            are unknown.
        direction: The direction in which the vehicle passes the scans, `None` while that is
            uncertain.
        stationary: Whether the vehicle is stationary, by its signatures alone.
        along_sigma_m: Standard deviation of the place along the path; `None` without poses.
        along_sigma_scans: The standard deviation along the path in scans of the map, where a stand
            counts as one.
        pose: The vehicle's pose: the match's estimated pose; in an encoding without one the place
            on the path between the scans. `None` without poses.
        timestamp_s: The observation's time, `None` if it had none.
        sequence: The observation's number, `None` if it had none.
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
    stationary: bool
    along_sigma_m: float | None
    along_sigma_scans: float
    pose: Pose | None
    timestamp_s: float | None = None
    sequence: int | None = None

    @property
    def row(self) -> int:
        """The nearest scan's row in the map."""
        return self.match.row

    @property
    def segment_sure(self) -> bool:
        """Whether the segment is certain, and not only the more likely of two that meet there."""
        return self.localized and self.segment_probability >= SURE
