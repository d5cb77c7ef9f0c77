"""Answers of a track, in their forms.

The layout of a packed answer is in docs/reference/http-api.md.
"""

import math
import struct
from dataclasses import dataclass

from app.http.answer_forms import Form, PackedType
from app.http.packed_numbers import as_half, as_single
from app.tracking.schemas import TrackStepOut
from core.mapping.georeference import Georeference
from core.tracking.step import Direction, Doubt, TrackStep

# Layout, flags and reason, segment, drive, scan, sequence, probability, distance, fraction, z, yaw,
# segment_probability, along_sigma in metres and in scans, lateral, relative yaw, x, y.
_STEP = struct.Struct("<BBHHIQ5f5e2d")
STEP = PackedType("application/vnd.tensormap.step", _STEP.size)
"""The media type of packed answers, and their size."""
STREAM_PROTOCOL = "tensormap.step"
"""WebSocket subprotocol of a stream of packed answers."""
_LAYOUT = 1
_LOCALIZED, _OF_LIVE, _SEGMENT_SURE, _STATIONARY, _ALONG, _AGAINST = 1, 2, 4, 8, 16, 32
_REASON_SHIFT = 6
_REASONS: tuple[Doubt | None, ...] = (None, *Doubt)
_NO_SEQUENCE = 2**64 - 1


def form_of(fields: str | None, accept: str | None) -> Form:
    """Return the form that a request asks for; see `Form.of`."""
    return Form.of(TrackStepOut, STEP, fields, accept)


@dataclass(frozen=True)
class StepAnswer:
    """The answer to an observation.

    Attributes:
        track: The track's name.
        step: The estimate.
        live_revision: The live revision of its map.
        georeference: Where its revision is on the Earth.
        drives: The names of its revision's drives.
    """

    track: str
    step: TrackStep
    live_revision: str | None
    georeference: Georeference
    drives: tuple[str, ...]

    def shown(self) -> TrackStepOut:
        """Return the model of the whole answer."""
        return TrackStepOut.from_core(self.track, self.step, self.live_revision, self.georeference)

    def packed(self) -> bytes:
        """Return it in 64 bytes; what is not known is NaN."""
        step = self.step
        match, pose = step.match, step.pose
        flags = (
            step.localized * _LOCALIZED
            | (step.revision == self.live_revision) * _OF_LIVE
            | step.segment_sure * _SEGMENT_SURE
            | step.stationary * _STATIONARY
            | (step.direction == Direction.ALONG) * _ALONG
            | (step.direction == Direction.AGAINST) * _AGAINST
            | _REASONS.index(step.reason) << _REASON_SHIFT
        )
        return _STEP.pack(
            _LAYOUT,
            flags,
            min(step.segment, 0xFFFF),
            min(self.drives.index(match.drive), 0xFFFF),
            min(match.scan_index, 0xFFFFFFFF),
            _NO_SEQUENCE if step.sequence is None else step.sequence,
            step.probability,
            as_single(match.distance if math.isfinite(match.distance) else None),
            step.fraction,
            math.nan if pose is None else pose.z_m,
            math.nan if pose is None else pose.yaw_deg,
            *map(
                as_half,
                (
                    step.segment_probability,
                    step.along_sigma_m,
                    step.along_sigma_scans,
                    match.lateral_m,
                    match.relative_yaw_deg,
                ),
            ),
            math.nan if pose is None else pose.x_m,
            math.nan if pose is None else pose.y_m,
        )
