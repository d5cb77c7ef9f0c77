"""The HTTP status of every error, and the errors that only a service raises."""

from collections.abc import Mapping, Sequence
from http import HTTPStatus
from types import MappingProxyType
from typing import Any

from app.http.answer_headers import AUTHENTICATE, CONTENT_RANGE, RETRY_AFTER, UPGRADE
from core import errors as core
from storage import errors as stored
from storage.formats import errors as formats


class AppError(core.TensorMapError):
    """Base of the errors that only a service has.

    Attributes:
        headers: Additional fields of the answer's head.
        more: Additional members of the problem.
    """

    headers: Mapping[str, str] = MappingProxyType({})
    more: Mapping[str, Any] = MappingProxyType({})


class InvalidRequest(AppError):
    """A parameter or JSON body that is not as the API describes it."""


class RangeNotSatisfiable(AppError):
    """A part of a file that begins behind its end; `Content-Range` has its length."""

    def __init__(self, detail: str, size_bytes: int) -> None:
        super().__init__(detail)
        self.headers = {CONTENT_RANGE: f"bytes */{size_bytes}"}


class BodyTooLarge(AppError):
    """A body longer than the service reads."""


class UnsupportedBody(AppError):
    """A body of a type or encoding that this route does not take."""


class MalformedBody(AppError):
    """A compressed body that does not decompress."""


class DigestMismatch(AppError):
    """A body with another digest than its Content-Digest."""


class SlowBody(AppError):
    """A body that arrives too slowly; what was stored of it stays."""


class MalformedUpload(AppError):
    """A body of many scans that is no tar stream, or incomplete; an upload keeps earlier scans."""


class NothingStored(AppError):
    """A body of many scans of which no file can be used; `set_aside` has the reasons."""

    def __init__(self, detail: str, set_aside: Sequence[Mapping[str, str]] = ()) -> None:
        super().__init__(detail)
        self.more = {"set_aside": set_aside}


class CaptureTooLarge(AppError):
    """A capture of more bytes, parts or returns than the service reads."""


class CaptureTooSlow(AppError):
    """A capture that takes longer to read than one may; its job was ended."""


class KeyNeeded(AppError):
    """A request without a key, to a service that needs one."""

    # RFC 6750: the answer to a request without a key names the scheme only.
    headers = MappingProxyType({AUTHENTICATE: "Bearer"})


class KeyRefused(AppError):
    """A key that is unknown to this service, or no longer valid."""

    headers = MappingProxyType({AUTHENTICATE: 'Bearer error="invalid_token"'})


class ScopeMissing(AppError):
    """A key that does not allow this request."""

    def __init__(self, detail: str, scopes: tuple[str, ...] = ()) -> None:
        super().__init__(detail)
        needed = f', scope="{" ".join(scopes)}"' if scopes else ""
        self.headers = {AUTHENTICATE: f'Bearer error="insufficient_scope"{needed}'}


class TooManyRequests(AppError):
    """More requests, or bytes, than a key may send in this time or have open; see `Retry-After`."""

    def __init__(
        self, detail: str, wait_s: int, headers: Mapping[str, str] = MappingProxyType({})
    ) -> None:
        super().__init__(detail)
        self.headers = {RETRY_AFTER: str(wait_s), **headers}


class ServiceBusy(AppError):
    """A service that has too many requests or bytes at once, or is stopping; see `Retry-After`."""

    def __init__(self, detail: str, wait_s: int) -> None:
        super().__init__(detail)
        self.headers = {RETRY_AFTER: str(wait_s)}


class HostNotAllowed(AppError):
    """A request to a service without keys under a foreign name, from a proxy or another site."""


class NoSuchRoute(AppError):
    """A path that the API does not have."""


class MethodNotAllowed(AppError):
    """A method that this path does not have; `Allow` lists its methods."""


class UpgradeRequired(AppError):
    """A request over HTTP for what is sent over a WebSocket."""

    # RFC 9110: the answer names the protocol, and that it is of this connection.
    headers = MappingProxyType({UPGRADE: "websocket", "Connection": "Upgrade"})


class TrackNotFound(AppError):
    """A track that does not exist, or no longer."""


class TooManyTracks(AppError):
    """A new track, while the service's limit of tracks is reached."""


class TooManyTracksOfKey(AppError):
    """A new track of a key that has reached its limit of tracks."""


class TooManyMaps(AppError):
    """A query that names no map and would open more maps than the limit for a query."""


class TooManyStreams(AppError):
    """A new stream, of a track or of a job's events, while the service's limit is reached."""


class TooManyStreamsOfKey(AppError):
    """A new stream of a key that has reached its limit of open streams."""


class TooManyConnections(AppError):
    """A new connection, while the limit is reached and no connection is idle."""

    headers = MappingProxyType({RETRY_AFTER: "1", "Connection": "close"})


class WorkerDied(AppError):
    """The process of a job ended before the job did."""


class BuildStalled(AppError):
    """A job (a build or a capture) that made no progress for too long; its process was ended."""


class BuildOutOfMemory(AppError):
    """A job (a build or a capture) that needed too much memory; its process was ended."""


class InternalError(AppError):
    """An internal error of the service; its log has the details."""


S = HTTPStatus
STATUS: dict[type[core.TensorMapError], HTTPStatus] = {
    core.InvalidScan: S.UNPROCESSABLE_ENTITY,
    core.TooFewReturns: S.UNPROCESSABLE_ENTITY,
    core.InvalidPose: S.UNPROCESSABLE_ENTITY,
    core.InvalidImage: S.UNPROCESSABLE_ENTITY,
    core.InvalidParameters: S.UNPROCESSABLE_ENTITY,
    core.InvalidMap: S.UNPROCESSABLE_ENTITY,
    core.InvalidSignature: S.UNPROCESSABLE_ENTITY,
    core.StaleSignature: S.CONFLICT,
    core.BasisMismatch: S.CONFLICT,
    core.FramesDisagree: S.CONFLICT,
    core.PosesContradictScans: S.CONFLICT,
    core.AnchorDoesNotFit: S.CONFLICT,
    core.UnknownDrive: S.NOT_FOUND,
    core.StaleObservation: S.CONFLICT,
    core.UnknownSegment: S.UNPROCESSABLE_ENTITY,
    core.SensorMismatch: S.UNPROCESSABLE_ENTITY,
    core.EmptyDrive: S.UNPROCESSABLE_ENTITY,
    core.Cancelled: S.CONFLICT,
    formats.EmptyBody: S.UNPROCESSABLE_ENTITY,
    formats.TruncatedScan: S.UNPROCESSABLE_ENTITY,
    formats.WrongDtype: S.UNPROCESSABLE_ENTITY,
    formats.MalformedScan: S.UNPROCESSABLE_ENTITY,
    formats.ScanTooLarge: S.REQUEST_ENTITY_TOO_LARGE,
    formats.UnknownFormat: S.UNSUPPORTED_MEDIA_TYPE,
    formats.UnknownDriveLayout: S.UNPROCESSABLE_ENTITY,
    formats.MalformedDrive: S.UNPROCESSABLE_ENTITY,
    stored.MapNotFound: S.NOT_FOUND,
    stored.DriveNotFound: S.NOT_FOUND,
    stored.ScanNotFound: S.NOT_FOUND,
    stored.RevisionNotFound: S.NOT_FOUND,
    stored.BasisNotFound: S.NOT_FOUND,
    stored.JobNotFound: S.NOT_FOUND,
    stored.NotInRecycleBin: S.NOT_FOUND,
    stored.CaptureNotFound: S.NOT_FOUND,
    stored.KeyNotFound: S.NOT_FOUND,
    stored.MapExists: S.CONFLICT,
    stored.DriveExists: S.CONFLICT,
    stored.MapChanged: S.PRECONDITION_FAILED,
    stored.ScanConflict: S.CONFLICT,
    stored.PosesDoNotFit: S.CONFLICT,
    stored.DriveClosed: S.CONFLICT,
    stored.ReturnsGone: S.CONFLICT,
    stored.NoLiveRevision: S.CONFLICT,
    stored.MapNotAnchored: S.CONFLICT,
    stored.RevisionIsLive: S.CONFLICT,
    stored.AmbiguousRevision: S.CONFLICT,
    stored.BasisExists: S.CONFLICT,
    stored.BasisInUse: S.CONFLICT,
    stored.JobNotRunning: S.CONFLICT,
    stored.PartConflict: S.CONFLICT,
    stored.PartsMissing: S.CONFLICT,
    stored.CaptureMismatch: S.CONFLICT,
    stored.CaptureQueued: S.CONFLICT,
    stored.RequestKeyReused: S.CONFLICT,
    stored.PartDoesNotFit: S.UNPROCESSABLE_ENTITY,
    stored.TooManyBuilds: S.TOO_MANY_REQUESTS,
    stored.TooManyCaptures: S.TOO_MANY_REQUESTS,
    stored.TooManyTokens: S.TOO_MANY_REQUESTS,
    stored.InvalidSlug: S.UNPROCESSABLE_ENTITY,
    stored.CorruptFile: S.INTERNAL_SERVER_ERROR,
    stored.CorruptImages: S.INTERNAL_SERVER_ERROR,
    stored.StorageBusy: S.SERVICE_UNAVAILABLE,
    stored.StorageFull: S.INSUFFICIENT_STORAGE,
    stored.StorageReadOnly: S.SERVICE_UNAVAILABLE,
    stored.StorageUnavailable: S.SERVICE_UNAVAILABLE,
    stored.WrongCatalog: S.SERVICE_UNAVAILABLE,
    stored.DataDirInUse: S.SERVICE_UNAVAILABLE,
    InvalidRequest: S.UNPROCESSABLE_ENTITY,
    RangeNotSatisfiable: S.REQUESTED_RANGE_NOT_SATISFIABLE,
    BodyTooLarge: S.REQUEST_ENTITY_TOO_LARGE,
    UnsupportedBody: S.UNSUPPORTED_MEDIA_TYPE,
    MalformedBody: S.BAD_REQUEST,
    DigestMismatch: S.BAD_REQUEST,
    SlowBody: S.REQUEST_TIMEOUT,
    MalformedUpload: S.UNPROCESSABLE_ENTITY,
    NothingStored: S.UNPROCESSABLE_ENTITY,
    CaptureTooLarge: S.REQUEST_ENTITY_TOO_LARGE,
    CaptureTooSlow: S.INTERNAL_SERVER_ERROR,
    KeyNeeded: S.UNAUTHORIZED,
    KeyRefused: S.UNAUTHORIZED,
    ScopeMissing: S.FORBIDDEN,
    TooManyRequests: S.TOO_MANY_REQUESTS,
    ServiceBusy: S.SERVICE_UNAVAILABLE,
    HostNotAllowed: S.MISDIRECTED_REQUEST,
    NoSuchRoute: S.NOT_FOUND,
    MethodNotAllowed: S.METHOD_NOT_ALLOWED,
    UpgradeRequired: S.UPGRADE_REQUIRED,
    TrackNotFound: S.NOT_FOUND,
    TooManyTracks: S.SERVICE_UNAVAILABLE,
    TooManyTracksOfKey: S.TOO_MANY_REQUESTS,
    TooManyMaps: S.UNPROCESSABLE_ENTITY,
    TooManyStreams: S.SERVICE_UNAVAILABLE,
    TooManyStreamsOfKey: S.TOO_MANY_REQUESTS,
    TooManyConnections: S.SERVICE_UNAVAILABLE,
    WorkerDied: S.INTERNAL_SERVER_ERROR,
    BuildStalled: S.INTERNAL_SERVER_ERROR,
    BuildOutOfMemory: S.INTERNAL_SERVER_ERROR,
    InternalError: S.INTERNAL_SERVER_ERROR,
}

READING = (stored.StorageBusy, stored.StorageUnavailable, InternalError)
"""Errors of every route that reads the store."""
WRITING = (*READING, stored.StorageFull, stored.StorageReadOnly)
"""Errors of every route that writes to it."""
ANY_BODY = (
    BodyTooLarge,
    UnsupportedBody,
    MalformedBody,
    DigestMismatch,
    SlowBody,
    stored.StorageFull,  # a large body is on the disk until it is complete
    stored.StorageReadOnly,
)
"""Errors of every route that reads a body."""
BAD_SCAN = (
    formats.EmptyBody,
    formats.TruncatedScan,
    formats.WrongDtype,
    formats.MalformedScan,
    core.TooFewReturns,
    core.InvalidScan,
    formats.UnknownFormat,
    *ANY_BODY,
    formats.ScanTooLarge,
)
"""Errors of every route that takes a scan."""
JSON_BODY = (InvalidRequest, *ANY_BODY)
"""Errors of every route that takes JSON."""
KEY = (KeyNeeded, KeyRefused, HostNotAllowed, ScopeMissing, ServiceBusy, TooManyRequests)
"""Errors of every route that needs a key."""
NAMED_REVISION = (stored.MapNotFound, stored.RevisionNotFound, stored.AmbiguousRevision)
"""Errors of every route that looks a revision up by its digest."""
REVISION = (stored.NoLiveRevision, *NAMED_REVISION, stored.CorruptFile)
"""Errors of every route that reads that or the live revision."""
