"""What an evaluation found."""

from dataclasses import dataclass
from typing import Any

from core.encodings.compression import Compression
from core.evaluation.condition import Condition
from core.evaluation.plain import Plain
from core.evaluation.reliability import Reliability
from core.evaluation.tracks import TrackResult
from core.projection.images import Skipped


@dataclass(frozen=True)
class SegmentError:
    """A query that was put on a wrong segment.

    Attributes:
        scan: The query's index in its drive.
        matched_scan: Index of the map scan that it was taken for.
        segment: Where it belongs.
        matched_segment: Where it was put.
        standing: Whether the vehicle stood, `None` without poses.
        motion_surrogate: The paper's norm of the 6-DOF change, `None` without poses.
    """

    scan: int
    matched_scan: int
    segment: int
    matched_segment: int
    standing: bool | None
    motion_surrogate: float | None


@dataclass(frozen=True)
class ConditionResult(Plain):
    """All queries under one condition; what does not apply is `None`.

    Attributes:
        condition: The disturbance.
        queries: How many scans were queried.
        refusals: How many got no answer; they count in none of the figures below.
        segment_accuracy: Share of answers on the right segment.
        errors: Answers on a wrong segment, one by one.
        errors_moving: How many of them while the vehicle moved.
        errors_stationary: How many while it stood.
        recall_at_1: Share of answers whose map scan was recorded within so many metres.
        position_error_m_median: Median distance of the estimated position, or of the matched scan
            where none is estimated, from the displaced vehicle.
        heading_error_deg_median: Median error of the estimated heading; the paper's encoding
            estimates none.
        lateral_error_m_median: Median error of the estimated offset to the left of the matched
            scan; the paper's encoding estimates none.
        ms_per_query: Mean wall time from returns to answer, projection included.
        reliability: Of the probabilities; `None` without calibration or poses.
    """

    condition: Condition
    queries: int
    refusals: int
    segment_accuracy: float | None
    errors: tuple[SegmentError, ...]
    errors_moving: int | None
    errors_stationary: int | None
    recall_at_1: dict[float, float | None]
    position_error_m_median: float | None
    heading_error_deg_median: float | None
    lateral_error_m_median: float | None
    ms_per_query: float | None
    reliability: Reliability | None

    def as_dict(self) -> dict[str, Any]:
        """Return plain values, `errors` as their number."""
        found = super().as_dict()
        return {
            **found.pop("condition"),
            **found,
            "errors": None if self.segment_accuracy is None else len(self.errors),
            "error_scans": found["errors"],
        }


@dataclass(frozen=True)
class Evaluation(Plain):
    """A map of one part of a drive, queried with the other part or with another drive.

    Attributes:
        drive: Name of the mapped drive; `query_drive` is `None` if its own scans are the queries.
        unknown_drives: Names of the drives whose places the map does not have.
        calibrated: Whether the map gives probabilities.
        segments: L.
        segmentation: How they were cut.
        split: How the queries were held out, `None` with a query drive.
        distance: How harmonic signatures are compared, `None` in the paper's encoding.
        lateral_renderings_m: From where the map's scans were rendered, `None` likewise.
        map_scans: How many scans made the map.
        standing_scans: Queries taken standing, `None` without poses.
        motion_surrogate_median_standing: Median norm of the 6-DOF change of those queries.
        motion_surrogate_median_moving: The same of all others.
        skipped: Scans that could not be mapped.
        compression: Against the map's own images and returns.
        relative_error: |X - X^| / |X| of each segment.
        conditions: The figures, one entry a disturbance.
        tracks: The same of the queries tracked as one drive; empty without tracking.
    """

    drive: str
    query_drive: str | None
    unknown_drives: tuple[str, ...]
    calibrated: bool
    encoding: str
    ranks: tuple[int, int]
    segments: int
    segmentation: str
    split: str | None
    reducer: str
    image: str
    distance: str | None
    lateral_renderings_m: tuple[float, ...] | None
    sensor: str
    sensor_height_m: float
    seed: int
    map_scans: int
    standing_scans: int | None
    motion_surrogate_median_standing: float | None
    motion_surrogate_median_moving: float | None
    skipped: tuple[Skipped, ...]
    compression: Compression
    relative_error: tuple[float, ...]
    conditions: tuple[ConditionResult, ...]
    tracks: tuple[TrackResult, ...] = ()
