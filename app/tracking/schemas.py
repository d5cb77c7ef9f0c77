"""Tracks on the wire."""

import math
from collections.abc import Collection
from contextlib import suppress
from datetime import UTC, datetime
from typing import Annotated, Any, Self

from pydantic import BaseModel, Field, Strict, ValidationError, field_validator

from app.drives.pose_schemas import PoseOut
from app.http.answer_fields import MOST_FIELDS_CHARACTERS, known_fields
from app.http.exact_types import Number, Seconds, integers
from app.http.shown import Shown
from app.localization.sensor_schemas import SensorIn
from app.localization.signature_schemas import SignaturesIn
from app.tracking.live_track import LiveTrack
from core.encodings.signature import Signature
from core.mapping.anchor import Anchor
from core.mapping.georeference import NOWHERE, Georeference
from core.projection.imager import Image
from core.tracking.step import Direction, Doubt, TrackStep
from core.tracking.track import MOST_TRAVELLED_M, Observation
from storage.catalog import SavedTrack

_IS_ASIDE = "is_aside"  # of a saved answer: it lies in a drive without a place on the Earth


class ObservationIn(SignaturesIn):
    """One scan's signatures and, if known, their time and the odometry since the last one."""

    timestamp_s: Annotated[Seconds, Strict()] | None = Field(
        None, description="Seconds by the vehicle's own clock; rises."
    )
    sequence: int | None = Field(
        None, ge=0, lt=2**53, description="The observation's number; rises."
    )
    travelled_m: Number | None = Field(
        None,
        ge=-MOST_TRAVELLED_M,
        le=MOST_TRAVELLED_M,
        description="Odometry since the last one in metres, negative backwards.",
    )

    _sequence = field_validator("sequence", mode="before")(integers)

    def to_observation(self) -> Observation:
        """Return the observation.

        Raises:
            InvalidSignature: If a signature is malformed.
        """
        return Observation(self.to_core(), self.timestamp_s, self.sequence, self.travelled_m)


class TrackStepOut(Shown):
    """The estimated place of the vehicle.

    The most likely place is returned in any case; `localized` says whether it is accepted.
    """

    track: str
    revision: str = Field(description="The revision that the track is pinned to.")
    live_revision: str | None = Field(description="The revision that is live now.")
    observations: int = Field(description="Number of observations of the track.")
    timestamp_s: float | None = Field(
        None, description="Time of the answered observation; null if it had none."
    )
    sequence: int | None = Field(None, description="Number of the answered observation.")
    localized: bool
    reason: Doubt | None = Field(description="Why it is not localized; null if it is.")
    segment: int = Field(
        description="The segment. Of those that were cut while the mapping vehicle stood in one"
        " place, the last."
    )
    segment_probability: float = Field(
        description="Probability of the segment among those of its drive if the place is right;"
        " near a cut two are as likely. Other drives along the street do not lower it."
    )
    segment_sure: bool = Field(
        description="Whether it is certain: localized, and that probability is 0.9 or more."
    )
    fraction: float = Field(
        description="Position in the segment: 0 at its start, 1 at its end. Between scans of the"
        " map it follows the estimated pose."
    )
    drive: str
    scan_index: int = Field(description="Index of the nearest scan in that drive.")
    distance: float | None = Field(
        description="Distance of that scan's signature; null if its segment's was not sent."
    )
    probability: float = Field(
        description="Probability of being within 5 m of that scan, or as near as the scans beside "
        "it where these are farther, up to 10 m; without poses within 5 scans, or as many as"
        " usually are in 2.5 m."
    )
    direction: Direction | None = Field(
        description="Whether its scans are passed as recorded; null while that is uncertain."
    )
    standing: bool = Field(
        description="Whether the vehicle is stationary, by its signatures alone."
    )
    along_sigma_m: float | None = Field(
        description="Standard deviation along the path, at least that of a vehicle anywhere"
        " half-way to the next scans; null where the map has no poses."
    )
    along_variance_m2: float | None = Field(
        description="Variance along the path, the square of `along_sigma_m`."
    )
    along_sigma_scans: float = Field(
        description="Standard deviation along the path, in scans of the map;"
        " those of a place where the mapping vehicle stood count as one. At least 0.29."
    )
    turn_deg: float | None = Field(
        description="Relative yaw of the query; null in the paper's encoding."
    )
    lateral_m: float | None = Field(
        description="Lateral offset, positive to the left of that scan; null in the paper's"
        " encoding."
    )
    pose: PoseOut | None = Field(
        description="Where the vehicle is, as `estimated_pose` of a localization; null without"
        " poses."
    )

    @classmethod
    def from_core(
        cls,
        track: str,
        step: TrackStep,
        live_revision: str | None,
        georeference: Georeference = NOWHERE,
    ) -> "TrackStepOut":
        """Return the model of an answer."""
        sigma_m, match = step.along_sigma_m, step.match
        return cls.of(
            step,
            track=track,
            live_revision=live_revision,
            drive=match.drive,
            scan_index=match.scan_index,
            distance=match.distance if math.isfinite(match.distance) else None,
            along_variance_m2=None if sigma_m is None else sigma_m * sigma_m,
            turn_deg=match.relative_yaw_deg,
            standing=step.stationary,
            lateral_m=match.lateral_m,
            pose=georeference.pose(match.drive, step.pose),
        )


class ObservationQuery(SensorIn):
    """Query parameters of an observation."""

    timestamp_s: Seconds | None = Field(
        None, description="Seconds by the vehicle's own clock; rises in a track."
    )
    sequence: int | None = Field(
        None, ge=0, lt=2**53, description="The observation's number; rises."
    )
    travelled_m: float | None = Field(
        None,
        ge=-MOST_TRAVELLED_M,
        le=MOST_TRAVELLED_M,
        description="Odometry since the last observation in metres, negative backwards.",
    )
    fields: Annotated[str, known_fields(TrackStepOut)] | None = Field(
        None,
        max_length=MOST_FIELDS_CHARACTERS,
        description="The fields to answer with, separated by commas, as `localized,pose.x_m`; all"
        " without it.",
    )

    def to_core(self, signatures: tuple[Signature, ...], image: Image | None) -> Observation:
        """Return the observation of a scan's signatures, and of its image if it came."""
        return Observation(signatures, self.timestamp_s, self.sequence, self.travelled_m, image)


class TrackOut(Shown):
    """A track and its last answer."""

    track: str = Field(description="The track's name.")
    map: str
    revision: str = Field(description="The revision that the track is pinned to.")
    live_revision: str | None = Field(description="The revision that is live now.")
    idle_s: float = Field(description="Time after its last use when it is removed.")
    last: TrackStepOut | None = Field(description="Its last answer; null before the first.")

    @classmethod
    def from_track(
        cls,
        found: LiveTrack,
        map_slug: str,
        live_revision: str | None,
        idle_s: float,
        georeference: Georeference = NOWHERE,
    ) -> "TrackOut":
        """Return the model of a track."""
        last = found.saved.last
        if found.last is not None:
            last = saved_answer(found.last, found.localizer.map.drives_aside)
        shown = None
        if last is not None:
            with suppress(KeyError, ValidationError):  # saved by another version
                pose = georeference.with_wgs84(last["drive"], last["pose"])
                shown = TrackStepOut.model_validate(
                    {**last, "track": found.id, "live_revision": live_revision, "pose": pose}
                )
        return cls.of(
            found,
            track=found.id,
            map=map_slug,
            live_revision=live_revision,
            idle_s=idle_s,
            last=shown,
        )


class TrackPlaceOut(BaseModel):
    """The place in a track's last answer."""

    localized: bool
    reason: Doubt | None = Field(description="Why it is not localized; null if it is.")
    segment: int
    fraction: float = Field(description="Position in the segment: 0 at its start, 1 at its end.")
    drive: str
    scan_index: int = Field(description="Index of the nearest scan in that drive.")
    pose: PoseOut | None = Field(description="Where the vehicle is; null without poses.")


class TrackListed(BaseModel):
    """A track in a list."""

    track: str = Field(description="The track's name.")
    key: str = Field(description="Id of the key that created it.")
    revision: str = Field(description="The revision that the track is pinned to.")
    created_at: datetime
    last_observation_at: datetime | None = Field(
        description="Time; null before the first observation."
    )
    observations: int = Field(description="Number of observations of the track.")
    place: TrackPlaceOut | None = Field(
        description="Place of its last answer; null before the first observation."
    )

    @classmethod
    def from_saved(cls, found: SavedTrack, anchor: Anchor | None) -> Self:
        """Return the model of a track as it is saved, in a map with an anchor or without one."""
        at_s, place, last = found.observed_s, None, found.last
        if last is not None:
            on_earth = NOWHERE if last.get(_IS_ASIDE, True) else Georeference(anchor, ())
            with suppress(KeyError, ValidationError):  # saved by another version
                pose = on_earth.with_wgs84(last["drive"], last["pose"])
                place = TrackPlaceOut.model_validate({**last, "pose": pose})
        return cls(
            track=found.id,
            key=found.key_id,
            revision=found.revision,
            created_at=found.created_at,
            last_observation_at=None if at_s is None else datetime.fromtimestamp(at_s, UTC),
            observations=found.observations,
            place=place,
        )


def saved_answer(step: TrackStep, aside: Collection[str]) -> dict[str, Any]:
    """Return an answer in plain values, without what is not the track's own.

    Args:
        step: The answer.
        aside: The drives of the map that lie beside the others; the list of tracks reads no map.
    """
    shown = TrackStepOut.from_core("", step, None)
    return {
        **shown.model_dump(mode="json", exclude={"track", "live_revision"}),
        _IS_ASIDE: step.match.drive in aside,
    }
