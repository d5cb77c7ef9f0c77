"""What schemathesis needs to reach deep code: real bodies of every media type, and real names."""

import io
import itertools
import tarfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import schemathesis
from fastapi import FastAPI
from hypothesis import strategies as st
from schemathesis.core.parameters import ParameterLocation
from starlette.types import Receive, Scope, Send

from app.drives.pose_files import CSV, KITTI, POSE_TYPES, TUM
from app.localization.query_bodies import BATCH_TYPE, IMAGE_TYPE, SIGNATURE_TYPE
from app.localization.query_schemas import PriorsIn
from core.encodings.signature import pack_signatures
from core.localization.localizer import Localizer
from storage.formats.scans.registry import SCAN_FORMATS
from tests.support.recording import kitti, npy, recording

_HDF5 = "application/vnd.tensormap.map+hdf5"
_TAR = "application/x-tar"
_POSES = {
    KITTI: [b"1 0 0 1.5 0 1 0 -2 0 0 1 1.73\n"],
    TUM: [b"# t x y z qx qy qz qw\n12.5 1 2 3 0 0 0 1\n"],
    CSV: [b"scan,x,y,z,qx,qy,qz,qw,timestamp_s\n3,1,2,3,0,0,0,1,0.25\n"],
}
_PRIORS = set(PriorsIn.model_fields)


class Bridge:
    """The application that schemathesis calls; it leads to the service that runs now.

    Attributes:
        app: That service.
    """

    app: FastAPI

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on; the caller does not decide when the service begins and ends."""
        if scope["type"] != "lifespan":
            await self.app(scope, receive, send)
            return
        for phase in ("startup", "shutdown"):
            await receive()
            await send({"type": f"lifespan.{phase}.complete"})


@dataclass
class KnownNames:
    """Names of what the service has, put into three quarters of the requests.

    A path that was meant to be wrong is left as it is.

    Attributes:
        of: By operation and place, as `path.map`, gives the next name to use.
    """

    of: dict[str, Iterator[str]] = field(default_factory=dict)
    _turns: Iterator[int] = field(default_factory=itertools.count)

    def put_into(self, case: Any) -> None:
        """Change a generated request."""
        meta = case.meta
        seen = (case.headers or {}).get("if-match")
        if seen is not None and seen.isdecimal() and meta.generation.mode.is_positive:
            case.headers["if-match"] = f'"{seen}"'  # the coverage phase takes off the quotes
        turn = next(self._turns)
        if turn % 4 == 3:
            return
        if turn % 2 and not meta.is_negative_at(ParameterLocation.QUERY):
            for name in _PRIORS & case.query.keys():  # most that are drawn are incomplete
                del case.query[name]
        for place, values in (
            (ParameterLocation.PATH, case.path_parameters),
            (ParameterLocation.QUERY, case.query),
            (ParameterLocation.BODY, case.body),
        ):
            if not isinstance(values, dict) or meta.is_negative_at(place):
                continue
            for name, value in values.items():
                names = self.of.get(f"{place.value}.{name}")
                if names is not None and isinstance(value, str):
                    values[name] = next(names)


def without_long_lists(schema: Any, longest: int = 20) -> Any:
    """Return a document that sets no bounds to lists of more than `longest`.

    To make a list of a thousand names, and one of a thousand and one, takes schemathesis seconds.
    """
    if isinstance(schema, list):
        return [without_long_lists(item, longest) for item in schema]
    if not isinstance(schema, dict):
        return schema
    return {
        name: without_long_lists(item, longest)
        for name, item in schema.items()
        if name != "maxItems" or not isinstance(item, int) or item <= longest
    }


def register_bodies(localizer: Callable[[], Localizer], map_file: Callable[[], bytes]) -> None:
    """Give schemathesis valid bytes of our media types.

    Some are good, some were good before they were cut or changed, and some never were.

    Args:
        localizer: Gives that of the live revision; called when the first body is made.
        map_file: Gives that revision's file, likewise.
    """
    scans = recording().scans
    scan_bodies = {
        "application/vnd.tensormap.kitti": [kitti(scans[3]), kitti(scans[30])],
        "application/vnd.tensormap.npy": [npy(scans[7].points_m)],
        "application/vnd.tensormap.csv": [
            b"x,y,z\n" + b"".join(b"%.2f,%.2f,%.2f\n" % tuple(p) for p in scans[7].points_m[:500])
        ],
    }
    for scan_format in SCAN_FORMATS:
        _register(scan_format.media_type, partial(scan_bodies.get, scan_format.media_type))
    # Its first bytes identify its format.
    _register("application/octet-stream", lambda: scan_bodies["application/vnd.tensormap.npy"])
    _register(_TAR, lambda: [_tar(kitti(scans[3]))])
    for media_type in POSE_TYPES:
        _register(media_type, partial(_POSES.get, media_type))

    def image() -> list[bytes]:
        grid = localizer().map.parameters.grid
        return [b"\x00\x00\x20\x41" * (grid.rows * grid.columns)]

    def signatures() -> list[bytes]:
        basis = localizer().basis
        return [pack_signatures(basis.encode(basis.image(scans[5], None)))]

    _register(IMAGE_TYPE, image)

    def batch() -> list[bytes]:
        return [b"".join(len(one).to_bytes(2, "little") + one for one in signatures() * 2)]

    _register(SIGNATURE_TYPE, signatures)
    _register(BATCH_TYPE, batch)
    _register(_HDF5, lambda: [map_file()])


def _register(media_type: str, good: Callable[[], list[bytes] | None]) -> None:
    schemathesis.openapi.media_type(media_type, st.deferred(lambda: _bodies(good() or [])))


def _bodies(good: list[bytes]) -> st.SearchStrategy[bytes]:
    never = st.binary(max_size=200)
    if not good:
        return never
    one = st.sampled_from(good)
    cut = st.builds(lambda body, share: body[: int(len(body) * share)], one, st.floats(0, 1))
    changed = st.builds(_with_byte, one, st.floats(0, 1, exclude_max=True), st.integers(0, 255))
    return one | one | cut | changed | never


def _with_byte(body: bytes, share: float, value: int) -> bytes:
    at = int(len(body) * share)
    return body[:at] + bytes([value]) + body[at + 1 :]


def _tar(scan: bytes) -> bytes:
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode="w") as archive:
        for name, content in (("000060.bin", scan), ("000061.bin", scan[:64])):
            member = tarfile.TarInfo(name)
            member.size = len(content)
            archive.addfile(member, io.BytesIO(content))
    return file.getvalue()
