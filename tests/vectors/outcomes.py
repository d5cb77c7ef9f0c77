"""What the service's own code makes of the kit's scans, signatures and answers."""

import math
import struct
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from app.localization.answers import pack
from app.localization.schemas import LocalizationOut
from app.localization.signature_schemas import HarmonicSignatureIn, SegmentSignatureIn
from app.revisions.loaded import Answering
from app.revisions.schemas import BasisOut
from core.arrays import Float32Array
from core.confidence.decision import Refusal
from core.encodings.basis import Basis
from core.encodings.registry import encoding_named
from core.encodings.signature import Packing, Signature, pack_signatures
from core.errors import InvalidScan, InvalidSignature
from core.localization.localizer import Localization
from core.projection.ground import ground_plane
from core.projection.imager import Image, Views
from core.projection.levelling import level
from core.scans.scan import Scan
from core.scans.tilt import Tilt
from storage.formats.scans.registry import media_type_of, read_scan

FOLDER = Path(__file__).parent
Values = dict[str, Any]


def scan_of(name: str) -> Scan:
    """Return the scan of a file in KITTI's format, without the rows that are no returns."""
    body = (FOLDER / "scans" / f"{name}.bin").read_bytes()
    return read_scan(body, min_returns=1, media_type=media_type_of("kitti"))


def basis_of(answer: Mapping[str, Any]) -> Basis:
    """Return the basis of an answer to `GET /v1/maps/{map}/basis`."""
    return BasisOut.model_validate(answer).to_core()


def signature_outcome(case: Mapping[str, Any], basis: Basis) -> Values:
    """Return what a scan becomes, step by step; `refused` if nothing is above the ground."""
    parameters, height_m = basis.parameters, case["sensor_height_m"]
    try:
        scan = scan_of(case["scan"])
        returns = len(scan)
        tilt = Tilt.of(case["roll_deg"], case["pitch_deg"])
        scan = scan if tilt is None else tilt.level(scan)
        image = basis.image(scan, height_m)
    except InvalidScan:
        return {"refused": True}
    found: Values = {"refused": False, "returns": returns}
    if parameters.views == Views.ANY:
        given = {"returns_m": scan.points_m, "sensor_height_m": height_m}
        found["plane"] = plane_outcome(given)
        scan = level(scan, height_m)
    found["levelled_crc32"] = _crc32(scan.points_m)
    found["image_crc32"] = _crc32(image.cells)
    found["occupied_cells"] = image.occupied_cells
    found["hidden"], found["rings"] = list(basis.view(image).hidden), basis.view(image).rings
    signatures = basis.encode(image)
    found["signatures"] = [plain(signature) for signature in signatures]
    found["packed"] = packed_of(basis, signatures)
    return found


def plane_outcome(case: Mapping[str, Any]) -> list[float] | None:
    """Return slopes and offset of the ground through some returns."""
    points_m = np.array(case["returns_m"], np.float32)
    plane = ground_plane(points_m, case["sensor_height_m"])
    return None if plane is None else [plane.slope_x, plane.slope_y, plane.offset_m]


def packed_of(basis: Basis, signatures: Sequence[Signature]) -> dict[str, str | None]:
    """Return a scan's signatures in each packing of their encoding, `None` where beyond one."""
    packed: dict[str, str | None] = {}
    for packing in basis.parameters.encoder.packings:
        try:
            packed[packing.value] = pack_signatures(signatures, packing).hex()
        except InvalidSignature:
            packed[packing.value] = None
    return packed


def plain(signature: Signature) -> Values:
    """Return a signature as it is in JSON."""
    values = encoding_named(signature.encoding).as_values(signature)
    return {"segment": None, "hidden": [], "rings": None, **values}


def signature_from(values: Mapping[str, Any], revision: str) -> Signature:
    """Return the signature of what `plain` returned."""
    given = {name: value for name, value in values.items() if value is not None}
    if "values" in given:
        del given["hidden"]
        model = SegmentSignatureIn(**given).model_dump()
        return encoding_named("paper").from_values(model, revision)
    model = HarmonicSignatureIn(**given).model_dump()
    return encoding_named("harmonic").from_values(model, revision)


def packing_outcome(case: Mapping[str, Any]) -> str:
    """Return the packed bytes of numbers, in hexadecimal digits."""
    signatures = [signature_from(values, case["basis"]) for values in case["signatures"]]
    return pack_signatures(signatures, Packing(case["packing"])).hex()


def answer_outcome(found: Localization, by: Answering) -> Values:
    """Return an answer in both forms, and what the packed one says."""
    packed = pack(found, by)
    whole = LocalizationOut.from_core(found, by.live_revision)
    return {
        "packed": packed.hex(),
        "decoded": decoded(packed),
        "json": whole.model_dump(mode="json"),
    }


def decoded(packed: bytes) -> Values:
    """Return what 60 bytes say, as docs/reference/http-api.md reads; NaN is null."""
    layout, flags, segment, drive, scan, revision, *numbers = struct.unpack(
        "<BBHHI8s5f3e2d", packed
    )
    assert layout == 1
    names = (
        *("probability", "distance", "ratio", "z_m", "yaw_deg"),
        *("along_std_m", "lateral_std_m", "heading_std_deg", "x_m", "y_m"),
    )
    known = (None if math.isnan(number) else number for number in numbers)
    return {
        "localized": bool(flags & 1),
        "of_live": bool(flags & 2),
        "estimated": bool(flags & 4),
        "reason": [None, *Refusal][flags >> 4],
        "segment": segment,
        "drive": drive,
        "scan_index": scan,
        "revision": revision.hex(),
        **dict(zip(names, known, strict=True)),
    }


def image_of(case: Mapping[str, Any], basis: Basis) -> Image:
    """Return the image of a case that is not refused."""
    tilt = Tilt.of(case["roll_deg"], case["pitch_deg"])
    scan = scan_of(case["scan"])
    return basis.image(scan if tilt is None else tilt.level(scan), case["sensor_height_m"])


def _crc32(values: Float32Array) -> str:
    return f"{zlib.crc32(values.astype('<f4').tobytes()):08x}"
