"""Answers to localizations, in their forms.

The layout of a packed answer is in docs/reference/http-api.md.
"""

import math
import struct
from collections.abc import Sequence

from fastapi import Response

from app.http.answer_forms import Form, PackedType
from app.http.packed_numbers import as_half, as_single
from app.localization.schemas import BatchOut, LocalizationOut
from app.revisions.loaded import Answering
from core.confidence.decision import Refusal
from core.encodings.signature import REVISION_PREFIX_BYTES
from core.localization.localizer import Localization

# Layout, flags and reason, segment, drive, scan, revision, probability, distance, ratio, z, yaw,
# three standard deviations, x, y.
_FIX = struct.Struct("<BBHHI8s5f3e2d")
FIX = PackedType("application/vnd.tensormap.fix", _FIX.size)
"""The media type of packed answers, and their size."""
_LAYOUT = 1
_LOCALIZED, _OF_LIVE, _ESTIMATED = 1, 2, 4
_REASON_SHIFT = 4
_REASONS: tuple[Refusal | None, ...] = (None, *Refusal)


def form_of(fields: str | None, accept: str | None) -> Form:
    """Return the form that a request asks for; see `Form.of`."""
    return Form.of(LocalizationOut, FIX, fields, accept)


def answer_of(
    form: Form, found: Localization, by: Answering, notes: Sequence[str] = ()
) -> LocalizationOut | Response:
    """Return the answer to one query."""
    return form.response(lambda: _shown(found, by, notes), lambda: pack(found, by))


def batch_of(form: Form, found: Sequence[tuple[Localization, Answering]]) -> BatchOut | Response:
    """Return the answers to several queries, in their order."""
    return form.of_each("items").response(
        lambda: BatchOut(items=[_shown(*one) for one in found]),
        lambda: b"".join(pack(*one) for one in found),
    )


def _shown(found: Localization, by: Answering, notes: Sequence[str] = ()) -> LocalizationOut:
    return LocalizationOut.from_core(found, by.live_revision, by.georeference, notes)


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
        deviations = deviation.along_m, deviation.lateral_m, found.heading_std_deg
    return _FIX.pack(
        _LAYOUT,
        flags,
        min(best.segment, 0xFFFF),
        min(by.localizer.map.trajectory.drives.index(best.drive), 0xFFFF),
        min(best.scan_index, 0xFFFFFFFF),
        bytes.fromhex(found.revision[: 2 * REVISION_PREFIX_BYTES]),
        as_single(found.decision.probability),
        as_single(best.distance),
        as_single(found.ratio),
        math.nan if pose is None else pose.z_m,
        math.nan if pose is None else pose.yaw_deg,
        *map(as_half, deviations),
        math.nan if pose is None else pose.x_m,
        math.nan if pose is None else pose.y_m,
    )
