"""Localizations on the wire."""

from collections.abc import Sequence
from typing import Any

from pydantic import AliasChoices, BaseModel, Field

from app.drives.pose_schemas import PoseOut
from app.http.shown import Shown
from core.confidence.decision import Refusal
from core.localization.localizer import Localization
from core.localization.match import Match
from core.mapping.georeference import NOWHERE, Georeference


class MatchOut(Shown):
    """A scan of the map, the matched scan, and the pose of the query: `estimated_pose`."""

    segment: int = Field(description="The segment of the matched scan.")
    fraction: float = Field(
        description="Position of the matched scan in the segment: 0 at its start, 1 at its end."
    )
    along_m: float | None = Field(
        description="Distance of the matched scan from the start of the segment, in metres; null"
        " without poses."
    )
    drive: str
    scan_index: int = Field(description="The scan's index in that drive.")
    distance: float = Field(
        description="Distance between the signatures: Frobenius; in a harmonic map the one it was"
        " built with."
    )
    timestamp_s: float | None = Field(description="Time of the matched scan.")
    pose: PoseOut | None = Field(
        description="Pose of the matched scan, not of the query; null without poses. The pose of"
        " the query is `estimated_pose`."
    )
    turn_deg: float | None = Field(
        validation_alias=AliasChoices("turn_deg", "relative_yaw_deg"),
        description="Yaw of the query relative to the matched scan, counter-clockwise, -180..180;"
        " null in the paper's encoding.",
    )
    lateral_m: float | None = Field(
        description="Lateral offset of the query from the matched scan, positive to its left; null"
        " in the paper's encoding."
    )
    heading_deg: float | None = Field(
        description="Heading of the query in the map's frame, counter-clockwise from x: the yaw of"
        " `estimated_pose`; null in the paper's encoding or without poses."
    )
    estimated_pose: PoseOut | None = Field(
        description="Where the vehicle is: pose of the query, between the scans of the map and"
        " beside them; null in the paper's encoding or without poses."
    )


class CovarianceOut(Shown):
    """Covariance of the position, in the map's frame."""

    xx_m2: float
    xy_m2: float
    yy_m2: float


class LocalizationOut(Shown):
    """Where the query was recorded.

    It has the nearest scan also if the query is refused: only with `localized` true is that the
    place.
    """

    revision: str = Field(description="The revision that answered.")
    live_revision: str = Field(description="The revision that is live now.")
    localized: bool = Field(description="Whether the best match is accepted.")
    reason: Refusal | None = Field(
        description="Why the best match is not accepted. `unknown_place`: no scan is near enough;"
        " `ambiguous`: one is, but another place is nearly as near; `too_few_returns`: the image"
        " has too few occupied cells, or its view is too small; `outside_prior`: no scan is within"
        " the priors, or one outside of them matches far better; `not_calibrated`:"
        " `min_probability` was given, and the map has no calibration."
    )
    probability: float | None = Field(
        description="Probability that the best match is right, if a query is as likely in the map"
        " as elsewhere; null from a map that is not calibrated: it refuses nothing for its"
        " distance."
    )
    along_std_m: float | None = Field(
        description="Standard deviation of `estimated_pose` along the path, if the match is right;"
        " null without calibration or poses."
    )
    lateral_std_m: float | None = Field(
        description="Standard deviation of `estimated_pose` across the path, if the match is right."
    )
    heading_std_deg: float | None = Field(
        description="Standard deviation of `heading_deg`, if the match is right; null in the"
        " paper's encoding."
    )
    position_covariance: CovarianceOut | None = Field(
        description="Covariance of the position of `estimated_pose` in the map's frame."
    )
    best: MatchOut = Field(
        description="The nearest scan; with priors the most likely one. Where the vehicle is:"
        " `estimated_pose`."
    )
    matches: list[MatchOut] = Field(
        description="The k nearest scans, nearest first; with priors the most likely first."
    )
    runner_up: MatchOut | None = Field(description="The nearest scan away from the best one.")
    ratio: float | None = Field(
        description="Distance of the best match divided by that of the runner-up."
    )
    segments_searched: list[int]
    notes: list[str] = Field(
        description="Notes for the client, of a scan that is not localized: that its axes are not x"
        " forward, y left, z up. Else empty."
    )

    @classmethod
    def from_core(
        cls,
        found: Localization,
        live_revision: str,
        georeference: Georeference = NOWHERE,
        notes: Sequence[str] = (),
    ) -> "LocalizationOut":
        """Return the model of a localization; of plain values, which pydantic validates at once."""
        deviation, decision = found.deviation, found.decision
        matches = [match_values(match, georeference) for match in found.matches]
        return cls.model_validate(
            {
                "revision": found.revision,
                "live_revision": live_revision,
                "localized": decision.localized,
                "reason": decision.reason,
                "probability": decision.probability,
                "along_std_m": deviation and deviation.along_m,
                "lateral_std_m": deviation and deviation.lateral_m,
                "heading_std_deg": found.heading_std_deg,
                "position_covariance": found.position_covariance_m2,
                "best": matches[0],
                "matches": matches,
                "runner_up": found.runner_up and match_values(found.runner_up, georeference),
                "ratio": found.ratio,
                "segments_searched": found.segments,
                "notes": notes,
            }
        )


def match_values(match: Match, georeference: Georeference = NOWHERE) -> dict[str, Any]:
    """Return plain values of a `MatchOut`."""
    estimated = georeference.pose(match.drive, match.estimated_pose)
    yaw_known = match.relative_yaw_deg is not None
    return {
        **vars(match),
        "pose": georeference.pose(match.drive, match.pose),
        "estimated_pose": estimated,
        "heading_deg": estimated["yaw_deg"] if estimated and yaw_known else None,
    }


class BatchOut(BaseModel):
    """The answers to several queries."""

    items: list[LocalizationOut] = Field(description="The answers in the order of the queries.")
