"""Answers of all maps on the wire."""

from collections.abc import Callable
from typing import Annotated

from pydantic import BaseModel, Field

from app.http.answer_fields import MOST_FIELDS_CHARACTERS, known_fields
from app.localization.all_maps_answer import AllMapsAnswer, Reason
from app.localization.schemas import CovarianceOut, MatchOut, match_values
from app.localization.sensor_schemas import SensorIn
from core.confidence.decision import Refusal
from core.localization.all_maps import MatchInMap
from core.mapping.georeference import NOWHERE, Georeference

_MOST_LISTED = 100


class MatchInMapOut(MatchOut):
    """A scan of one of the maps."""

    map: str
    revision: str = Field(description="The live revision of the map.")

    @classmethod
    def from_core(cls, found: MatchInMap, georeference: Georeference) -> "MatchInMapOut":
        """Return the model of a match."""
        values = match_values(found.match, georeference)
        return cls.model_validate({"map": found.name, "revision": found.revision, **values})


class NotSearchedOut(BaseModel):
    """A map that was not searched."""

    map: str
    reason: Reason = Field(
        description="`other_basis`: its live revision does not have the basis of the signature;"
        " `no_live_revision`: it has no revision, or was deleted meanwhile; `damaged`: its file"
        " cannot be read;"
        " `not_indexed`: it became live a moment ago, as more maps did than a query opens."
    )


class AllMapsAnswerOut(BaseModel):
    """Where the query was recorded, among all maps that the key may see."""

    map: str = Field(description="The map of the best match.")
    localized: bool = Field(description="Whether the best match is accepted.")
    reason: Refusal | None = Field(
        description="Why the best match is not accepted, as in the answer of one map."
    )
    probability: float | None = Field(
        description="Probability that the best match is right, if a query is as likely in one of"
        " the maps as in none; null from a map that is not calibrated."
    )
    along_std_m: float | None = Field(
        description="Standard deviation along the path, as in the answer of one map."
    )
    lateral_std_m: float | None
    heading_std_deg: float | None
    position_covariance: CovarianceOut | None = Field(
        description="Covariance of the position in that map's frame."
    )
    best: MatchInMapOut
    matches: list[MatchInMapOut] = Field(
        description="The nearest scans, best first: of several maps, by what is left of their"
        " distances between scans and viewpoints."
    )
    runner_up: MatchInMapOut | None = Field(
        description="The scan away from the best one, or in another map, that says most against it."
    )
    ratio: float | None = Field(
        description="Distance of the best match divided by that of the runner-up; of another map,"
        " what is left of both between scans and viewpoints. The latter counts for less, the more"
        " places were searched: one of many is near by chance."
    )
    maps_searched: int
    maps_not_searched: int
    not_searched: list[NotSearchedOut] = Field(
        description=f"The maps that were not searched: the first {_MOST_LISTED} by name."
    )
    notes: list[str] = Field(
        description="Notes for the client, of a scan that is not localized: that its axes are not x"
        " forward, y left, z up. Else empty."
    )

    @classmethod
    def from_core(
        cls,
        answer: AllMapsAnswer,
        georeference_of: Callable[[MatchInMap], Georeference] = lambda _: NOWHERE,
    ) -> "AllMapsAnswerOut":
        """Return the model of an answer.

        Args:
            answer: The answer.
            georeference_of: Returns where the map of a match is on the Earth; nowhere by default.
        """

        def shown(match: MatchInMap) -> MatchInMapOut:
            return MatchInMapOut.from_core(match, georeference_of(match))

        found = answer.found
        deviation, decision = found.deviation, found.decision
        best, covariance = found.best, found.position_covariance_m2
        return cls(
            map=best.name,
            localized=decision.localized,
            reason=decision.reason,
            probability=decision.probability,
            along_std_m=deviation and deviation.along_m,
            lateral_std_m=deviation and deviation.lateral_m,
            heading_std_deg=found.heading_std_deg,
            position_covariance=covariance and CovarianceOut.model_validate(covariance),
            best=shown(best),
            matches=[shown(match) for match in found.matches],
            runner_up=found.runner_up and shown(found.runner_up),
            ratio=found.ratio,
            maps_searched=answer.searched,
            maps_not_searched=len(answer.not_searched),
            not_searched=[
                NotSearchedOut(map=slug, reason=reason)
                for slug, reason in answer.not_searched[:_MOST_LISTED]
            ],
            notes=list(answer.notes),
        )


class AllMapsQuery(BaseModel):
    """Query parameters of a localization in all maps."""

    k: int = Field(1, ge=1, le=1000, description="How many matches to return.")
    min_probability: Annotated[float, Field(ge=0, le=1)] | None = Field(
        None,
        description="Least probability to accept; the threshold of the best map by default.",
    )
    fields: Annotated[str, known_fields(AllMapsAnswerOut)] | None = Field(
        None,
        max_length=MOST_FIELDS_CHARACTERS,
        description="The fields to answer with, separated by commas, as"
        " `map,localized,best.estimated_pose`; all without it.",
    )


class AllMapsScanQuery(AllMapsQuery, SensorIn):
    """Query parameters of the localization of a scan in all maps."""
