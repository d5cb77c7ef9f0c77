"""The forms of an answer: JSON of all fields, JSON of some, or packed into 60 bytes.

The layout of a packed answer is in docs/reference/http-api.md.
"""

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Header, Response
from pydantic import BaseModel

from app.http.errors import InvalidRequest
from app.localization.answer_fields import included
from app.localization.schemas import BatchOut, LocalizationOut
from app.revisions.loaded import Answering
from core.confidence.decision import Refusal
from core.encodings.signature import REVISION_PREFIX_BYTES
from core.localization.localizer import Localization

FIX_TYPE = "application/vnd.tensormap.fix"
PART_TYPE = "application/vnd.tensormap.part+json"
Accept = Annotated[str | None, Header(include_in_schema=False)]

# Layout, flags and reason, segment, drive, scan, revision, probability, distance, ratio, z, yaw,
# three standard deviations, x, y.
_FIX = struct.Struct("<BBHHI8s5f3e2d")
FIX_BYTES = _FIX.size
"""Of one packed answer."""
_LAYOUT = 1
_LOCALIZED, _OF_LIVE, _ESTIMATED = 1, 2, 4
_REASON_SHIFT = 4
_REASONS: tuple[Refusal | None, ...] = (None, *Refusal)
_LARGEST_HALF, _LARGEST = 65504.0, 3.4e38


def forms_of(what: str) -> dict[int | str, dict[str, Any]]:
    """Return the OpenAPI `responses` of a route that answers in these forms too."""
    return {
        200: {
            "content": {
                PART_TYPE: {
                    "schema": {
                        "type": "object",
                        "description": f"With `fields`: these fields of {what}, no others.",
                    }
                },
                FIX_TYPE: {
                    "schema": {
                        "type": "string",
                        "format": "binary",
                        "description": f"On `Accept: {FIX_TYPE}`: {FIX_BYTES} bytes an answer,"
                        " docs/reference/http-api.md.",
                    }
                },
            }
        }
    }


@dataclass(frozen=True)
class Form:
    """The form of an answer that a request asks for.

    Attributes:
        fields: As pydantic's `include`; all if `None`.
        packed: Whether it is packed instead.
    """

    fields: dict[str, Any] | None
    packed: bool

    @classmethod
    def of(cls, fields: str | None, accept: str | None) -> "Form":
        """Return the form for a `fields` that was checked, and the header `Accept`.

        Raises:
            InvalidRequest: If both came: a packed answer has the same fields always.
        """
        kinds = {kind.partition(";")[0].strip().lower() for kind in (accept or "").split(",")}
        packed = FIX_TYPE in kinds
        if packed and fields is not None:
            raise InvalidRequest(
                f"fields came with an Accept of {FIX_TYPE}, which has the same fields always:"
                " wanted one of both"
            )
        return cls(None if fields is None else included(fields), packed)

    def one(self, found: Localization, by: Answering) -> LocalizationOut | Response:
        """Return the answer to one query."""
        if self.packed:
            return Response(pack(found, by), media_type=FIX_TYPE)
        whole = LocalizationOut.from_core(found, by.live_revision, by.georeference)
        return whole if self.fields is None else _part(whole, self.fields)

    def many(self, found: Sequence[tuple[Localization, Answering]]) -> BatchOut | Response:
        """Return the answers to several queries, in their order."""
        if self.packed:
            return Response(b"".join(pack(*one) for one in found), media_type=FIX_TYPE)
        items = [
            LocalizationOut.from_core(one, by.live_revision, by.georeference) for one, by in found
        ]
        whole = BatchOut(items=items)
        return whole if self.fields is None else _part(whole, {"items": {"__all__": self.fields}})


def _part(whole: BaseModel, include: dict[str, Any]) -> Response:
    return Response(whole.model_dump_json(include=include), media_type=PART_TYPE)


def pack(found: Localization, by: Answering) -> bytes:
    """Return an answer in 60 bytes; what is not known is NaN."""
    best, deviation = found.best, found.deviation
    pose = best.estimated_pose or best.pose
    flags = (
        found.localized * _LOCALIZED
        | (found.revision == by.live_revision) * _OF_LIVE
        | (best.estimated_pose is not None) * _ESTIMATED
        | _REASONS.index(found.decision.reason) << _REASON_SHIFT
    )
    deviations: tuple[float | None, ...] = (None,) * 3
    if deviation is not None:
        heading_deg = None if best.heading_deg is None else deviation.heading_deg
        deviations = deviation.along_m, deviation.lateral_m, heading_deg
    return _FIX.pack(
        _LAYOUT,
        flags,
        min(best.segment, 0xFFFF),
        min(by.localizer.map.trajectory.drives.index(best.drive), 0xFFFF),
        min(best.scan_index, 0xFFFFFFFF),
        bytes.fromhex(found.revision[: 2 * REVISION_PREFIX_BYTES]),
        _or_nan(found.decision.probability),
        min(best.distance, _LARGEST),
        _or_nan(found.ratio),
        math.nan if pose is None else pose.z_m,
        math.nan if pose is None else pose.yaw_deg,
        *(min(_or_nan(value), _LARGEST_HALF) for value in deviations),
        math.nan if pose is None else pose.x_m,
        math.nan if pose is None else pose.y_m,
    )


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value
