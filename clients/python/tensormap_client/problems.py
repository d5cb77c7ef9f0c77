"""The types of the service's problems, as errors; made by `tests.docs.tables`."""

from tensormap_client.errors import Rejected


class InvalidScan(Rejected):
    """A scan that cannot be used."""

    problem = "invalid-scan"
    usual_status = 422


class InvalidPose(Rejected):
    """Poses or times that cannot be read, or a pose that is not a rigid motion."""

    problem = "invalid-pose"
    usual_status = 422


class InvalidImage(Rejected):
    """An image whose shape, kind or values do not fit its grid."""

    problem = "invalid-image"
    usual_status = 422


class InvalidParameters(Rejected):
    """A parameter out of its range."""

    problem = "invalid-parameters"
    usual_status = 422


class InvalidMap(Rejected):
    """Arrays that do not form a TensorMap."""

    problem = "invalid-map"
    usual_status = 422


class InvalidSignature(Rejected):
    """A signature with an invalid shape or invalid values."""

    problem = "invalid-signature"
    usual_status = 422


class StaleSignature(Rejected):
    """A signature made with bases that no available revision has."""

    problem = "stale-signature"
    usual_status = 409


class BasisMismatch(Rejected):
    """Maps whose bases differ cannot be merged without their images."""

    problem = "basis-mismatch"
    usual_status = 409


class FramesDisagree(Rejected):
    """Drives of one map whose poses are in different world frames."""

    problem = "frames-disagree"
    usual_status = 409


class PosesContradictScans(Rejected):
    """The scans of a drive show another motion than its poses."""

    problem = "poses-contradict-scans"
    usual_status = 409


class AnchorDoesNotFit(Rejected):
    """The track of a GNSS receiver does not fit a drive, or does not give its heading."""

    problem = "anchor-does-not-fit"
    usual_status = 409


class UnknownDrive(Rejected):
    """A drive that the map does not have."""

    problem = "unknown-drive"
    usual_status = 404


class StaleObservation(Rejected):
    """An observation that is not newer than the last one of its track."""

    problem = "stale-observation"
    usual_status = 409


class UnknownSegment(Rejected):
    """A segment that the map does not have."""

    problem = "unknown-segment"
    usual_status = 422


class SensorMismatch(Rejected):
    """A query of a sensor or grid that the map cannot answer."""

    problem = "sensor-mismatch"
    usual_status = 422


class EmptyDrive(Rejected):
    """A drive without a single scan."""

    problem = "empty-drive"
    usual_status = 422


class Cancelled(Rejected):
    """A long computation that its caller cancelled."""

    problem = "cancelled"
    usual_status = 409


class UnknownFormat(Rejected):
    """Bytes that no reader claims."""

    problem = "unknown-format"
    usual_status = 415


class UnknownDriveLayout(Rejected):
    """A folder that is laid out like no drive."""

    problem = "unknown-drive-layout"
    usual_status = 422


class MalformedDrive(Rejected):
    """Poses, times, a calibration or a GNSS track that cannot be used."""

    problem = "malformed-drive"
    usual_status = 422


class TooFewReturns(InvalidScan):
    """Fewer finite, non-zero returns than required."""

    problem = "too-few-returns"
    usual_status = 422


class EmptyBody(InvalidScan):
    """An empty body where a scan, a signature or a file was wanted."""

    problem = "empty-body"
    usual_status = 422


class TruncatedScan(InvalidScan):
    """Fewer bytes than the header says, or not a whole number of records."""

    problem = "truncated-scan"
    usual_status = 422


class WrongDtype(InvalidScan):
    """Numbers that are not metres in floating point."""

    problem = "wrong-dtype"
    usual_status = 422


class MalformedScan(InvalidScan):
    """A header or body that cannot be parsed."""

    problem = "malformed-scan"
    usual_status = 422


class ScanTooLarge(InvalidScan):
    """A scan of more returns, or that would unpack to more bytes, than a reader allows."""

    problem = "scan-too-large"
    usual_status = 413


class PartDoesNotFit(Rejected):
    """A part of another size, or of another number, than the capture has."""

    problem = "part-does-not-fit"
    usual_status = 422


class TooManyBuilds(Rejected):
    """A new job (a build or a capture) of a key that has reached its limit of queued jobs."""

    problem = "too-many-builds"
    usual_status = 429


class TooManyCaptures(Rejected):
    """A new capture of a key that has reached its limit of bytes of captures."""

    problem = "too-many-captures"
    usual_status = 429


class TooManyTokens(Rejected):
    """A new token of a key that has reached its limit of valid tokens."""

    problem = "too-many-tokens"
    usual_status = 429


class InvalidSlug(Rejected):
    """A name that is no slug."""

    problem = "invalid-slug"
    usual_status = 422


class CorruptFile(Rejected):
    """A file whose content is not what was written."""

    problem = "corrupt-file"
    usual_status = 500


class WrongCatalog(Rejected):
    """The catalog is not that of this data directory, or of another version of TensorMap."""

    problem = "wrong-catalog"
    usual_status = 503


class DataDirInUse(Rejected):
    """Another server already owns this data directory."""

    problem = "data-dir-in-use"
    usual_status = 503


class InvalidRequest(Rejected):
    """A parameter or JSON body that is not as the API describes it."""

    problem = "invalid-request"
    usual_status = 422


class RangeNotSatisfiable(Rejected):
    """A part of a file that begins behind its end; `Content-Range` has its length."""

    problem = "range-not-satisfiable"
    usual_status = 416


class BodyTooLarge(Rejected):
    """A body longer than the service reads."""

    problem = "body-too-large"
    usual_status = 413


class UnsupportedBody(Rejected):
    """A body of a type or encoding that this route does not take."""

    problem = "unsupported-body"
    usual_status = 415


class MalformedBody(Rejected):
    """A compressed body that does not decompress."""

    problem = "malformed-body"
    usual_status = 400


class DigestMismatch(Rejected):
    """A body with another digest than its Content-Digest."""

    problem = "digest-mismatch"
    usual_status = 400


class SlowBody(Rejected):
    """A body that arrives too slowly; what was stored of it stays."""

    problem = "slow-body"
    usual_status = 408


class MalformedUpload(Rejected):
    """A body of many scans that is no tar stream, or incomplete; an upload keeps earlier scans."""

    problem = "malformed-upload"
    usual_status = 422


class NothingStored(Rejected):
    """A body of many scans of which no file can be used; `set_aside` has the reasons."""

    problem = "nothing-stored"
    usual_status = 422


class CaptureTooLarge(Rejected):
    """A capture of more bytes, parts or returns than the service reads."""

    problem = "capture-too-large"
    usual_status = 413


class CaptureTooSlow(Rejected):
    """A capture that takes longer to read than one may; its job was ended."""

    problem = "capture-too-slow"
    usual_status = 500


class KeyNeeded(Rejected):
    """A request without a key, to a service that needs one."""

    problem = "key-needed"
    usual_status = 401


class KeyRefused(Rejected):
    """A key that is unknown to this service, or no longer valid."""

    problem = "key-refused"
    usual_status = 401


class ScopeMissing(Rejected):
    """A key that does not allow this request."""

    problem = "scope-missing"
    usual_status = 403


class TooManyRequests(Rejected):
    """More requests, or bytes, than a key may send in this time or have open; see `Retry-After`."""

    problem = "too-many-requests"
    usual_status = 429


class ServiceBusy(Rejected):
    """A service that has too many requests or bytes at once, or is stopping; see `Retry-After`."""

    problem = "service-busy"
    usual_status = 503


class HostNotAllowed(Rejected):
    """A request to a service without keys under a foreign name, from a proxy or another site."""

    problem = "host-not-allowed"
    usual_status = 421


class NoSuchRoute(Rejected):
    """A path that the API does not have."""

    problem = "no-such-route"
    usual_status = 404


class MethodNotAllowed(Rejected):
    """A method that this path does not have; `Allow` lists its methods."""

    problem = "method-not-allowed"
    usual_status = 405


class UpgradeRequired(Rejected):
    """A request over HTTP for what is sent over a WebSocket."""

    problem = "upgrade-required"
    usual_status = 426


class TrackNotFound(Rejected):
    """A track that does not exist, or no longer."""

    problem = "track-not-found"
    usual_status = 404


class TooManyTracks(Rejected):
    """A new track, while the service's limit of tracks is reached."""

    problem = "too-many-tracks"
    usual_status = 503


class TooManyTracksOfKey(Rejected):
    """A new track of a key that has reached its limit of tracks."""

    problem = "too-many-tracks-of-key"
    usual_status = 429


class TooManyMaps(Rejected):
    """A query that names no map and would open more maps than the limit for a query."""

    problem = "too-many-maps"
    usual_status = 422


class TooManyStreams(Rejected):
    """A new stream, of a track or of a job's events, while the service's limit is reached."""

    problem = "too-many-streams"
    usual_status = 503


class TooManyStreamsOfKey(Rejected):
    """A new stream of a key that has reached its limit of open streams."""

    problem = "too-many-streams-of-key"
    usual_status = 429


class TooManyConnections(Rejected):
    """A new connection, while the limit is reached and no connection is idle."""

    problem = "too-many-connections"
    usual_status = 503


class WorkerDied(Rejected):
    """The process of a job ended before the job did."""

    problem = "worker-died"
    usual_status = 500


class BuildStalled(Rejected):
    """A job (a build or a capture) that made no progress for too long; its process was ended."""

    problem = "build-stalled"
    usual_status = 500


class BuildOutOfMemory(Rejected):
    """A job (a build or a capture) that needed too much memory; its process was ended."""

    problem = "build-out-of-memory"
    usual_status = 500


class InternalError(Rejected):
    """An internal error of the service; its log has the details."""

    problem = "internal-error"
    usual_status = 500


class MapNotFound(Rejected):
    """A map that is not there."""

    problem = "map-not-found"
    usual_status = 404


class DriveNotFound(Rejected):
    """A drive that the map does not have."""

    problem = "drive-not-found"
    usual_status = 404


class ScanNotFound(Rejected):
    """A scan that the drive does not have."""

    problem = "scan-not-found"
    usual_status = 404


class RevisionNotFound(Rejected):
    """A revision that the map does not have, or no longer."""

    problem = "revision-not-found"
    usual_status = 404


class BasisNotFound(Rejected):
    """A shared basis that is not there."""

    problem = "basis-not-found"
    usual_status = 404


class JobNotFound(Rejected):
    """A job that is not there."""

    problem = "job-not-found"
    usual_status = 404


class NotInRecycleBin(Rejected):
    """A deleted map or drive that is not in the recycle bin, or no longer."""

    problem = "not-in-recycle-bin"
    usual_status = 404


class CaptureNotFound(Rejected):
    """An uploaded capture that is not there, or no longer."""

    problem = "capture-not-found"
    usual_status = 404


class KeyNotFound(Rejected):
    """A key that is not there."""

    problem = "key-not-found"
    usual_status = 404


class MapExists(Rejected):
    """Another map has this slug."""

    problem = "map-exists"
    usual_status = 409


class DriveExists(Rejected):
    """Another drive of the map has this slug."""

    problem = "drive-exists"
    usual_status = 409


class MapChanged(Rejected):
    """The map is no longer at the version that the caller saw."""

    problem = "map-changed"
    usual_status = 412


class ScanConflict(Rejected):
    """Other content is stored at this index."""

    problem = "scan-conflict"
    usual_status = 409


class PosesDoNotFit(Rejected):
    """Poses that cannot be those of the stored scans: too few, too many, or of another drive."""

    problem = "poses-do-not-fit"
    usual_status = 409


class DriveClosed(Rejected):
    """A closed drive takes no new scans."""

    problem = "drive-closed"
    usual_status = 409


class ReturnsGone(Rejected):
    """The returns of a scan were dropped after a build, by the map's retention policy."""

    problem = "returns-gone"
    usual_status = 409


class NoLiveRevision(Rejected):
    """The map has no revision to answer with yet."""

    problem = "no-live-revision"
    usual_status = 409


class MapNotAnchored(Rejected):
    """Where the map is on the Earth is not set."""

    problem = "map-not-anchored"
    usual_status = 409


class RevisionIsLive(Rejected):
    """The live revision cannot be deleted."""

    problem = "revision-is-live"
    usual_status = 409


class AmbiguousRevision(Rejected):
    """Several digests begin with this prefix."""

    problem = "ambiguous-revision"
    usual_status = 409


class BasisExists(Rejected):
    """Another shared basis has this name, or this one has another name."""

    problem = "basis-exists"
    usual_status = 409


class BasisInUse(Rejected):
    """A shared basis that revisions have, or that a queued or running build uses."""

    problem = "basis-in-use"
    usual_status = 409


class JobNotRunning(Rejected):
    """Only a running job makes progress or ends."""

    problem = "job-not-running"
    usual_status = 409


class PartConflict(Rejected):
    """Other bytes are stored as this part of a capture."""

    problem = "part-conflict"
    usual_status = 409


class PartsMissing(Rejected):
    """A capture of which parts are missing or were lost; it cannot be read without them."""

    problem = "parts-missing"
    usual_status = 409


class CaptureMismatch(Rejected):
    """A capture whose files have another digest than was announced."""

    problem = "capture-mismatch"
    usual_status = 409


class CaptureQueued(Rejected):
    """A capture that waits to be read, is read, or was read takes no more parts."""

    problem = "capture-queued"
    usual_status = 409


class RequestKeyReused(Rejected):
    """Another request was made under this idempotency key."""

    problem = "request-key-reused"
    usual_status = 409


class CorruptImages(CorruptFile):
    """Cached images that are not what was written; a build makes them anew, once."""

    problem = "corrupt-images"
    usual_status = 500


class StorageBusy(Rejected):
    """Another writer held the catalog for longer than the caller waits."""

    problem = "storage-busy"
    usual_status = 503


class StorageFull(Rejected):
    """No space or quota is left."""

    problem = "storage-full"
    usual_status = 507


class StorageReadOnly(Rejected):
    """The data cannot be written here."""

    problem = "storage-read-only"
    usual_status = 503


class StorageUnavailable(Rejected):
    """The disk, or the catalog's database, fails or cannot be reached."""

    problem = "storage-unavailable"
    usual_status = 503


PROBLEMS: dict[str, type[Rejected]] = {
    InvalidScan.problem: InvalidScan,
    InvalidPose.problem: InvalidPose,
    InvalidImage.problem: InvalidImage,
    InvalidParameters.problem: InvalidParameters,
    InvalidMap.problem: InvalidMap,
    InvalidSignature.problem: InvalidSignature,
    StaleSignature.problem: StaleSignature,
    BasisMismatch.problem: BasisMismatch,
    FramesDisagree.problem: FramesDisagree,
    PosesContradictScans.problem: PosesContradictScans,
    AnchorDoesNotFit.problem: AnchorDoesNotFit,
    UnknownDrive.problem: UnknownDrive,
    StaleObservation.problem: StaleObservation,
    UnknownSegment.problem: UnknownSegment,
    SensorMismatch.problem: SensorMismatch,
    EmptyDrive.problem: EmptyDrive,
    Cancelled.problem: Cancelled,
    UnknownFormat.problem: UnknownFormat,
    UnknownDriveLayout.problem: UnknownDriveLayout,
    MalformedDrive.problem: MalformedDrive,
    TooFewReturns.problem: TooFewReturns,
    EmptyBody.problem: EmptyBody,
    TruncatedScan.problem: TruncatedScan,
    WrongDtype.problem: WrongDtype,
    MalformedScan.problem: MalformedScan,
    ScanTooLarge.problem: ScanTooLarge,
    PartDoesNotFit.problem: PartDoesNotFit,
    TooManyBuilds.problem: TooManyBuilds,
    TooManyCaptures.problem: TooManyCaptures,
    TooManyTokens.problem: TooManyTokens,
    InvalidSlug.problem: InvalidSlug,
    CorruptFile.problem: CorruptFile,
    WrongCatalog.problem: WrongCatalog,
    DataDirInUse.problem: DataDirInUse,
    InvalidRequest.problem: InvalidRequest,
    RangeNotSatisfiable.problem: RangeNotSatisfiable,
    BodyTooLarge.problem: BodyTooLarge,
    UnsupportedBody.problem: UnsupportedBody,
    MalformedBody.problem: MalformedBody,
    DigestMismatch.problem: DigestMismatch,
    SlowBody.problem: SlowBody,
    MalformedUpload.problem: MalformedUpload,
    NothingStored.problem: NothingStored,
    CaptureTooLarge.problem: CaptureTooLarge,
    CaptureTooSlow.problem: CaptureTooSlow,
    KeyNeeded.problem: KeyNeeded,
    KeyRefused.problem: KeyRefused,
    ScopeMissing.problem: ScopeMissing,
    TooManyRequests.problem: TooManyRequests,
    ServiceBusy.problem: ServiceBusy,
    HostNotAllowed.problem: HostNotAllowed,
    NoSuchRoute.problem: NoSuchRoute,
    MethodNotAllowed.problem: MethodNotAllowed,
    UpgradeRequired.problem: UpgradeRequired,
    TrackNotFound.problem: TrackNotFound,
    TooManyTracks.problem: TooManyTracks,
    TooManyTracksOfKey.problem: TooManyTracksOfKey,
    TooManyMaps.problem: TooManyMaps,
    TooManyStreams.problem: TooManyStreams,
    TooManyStreamsOfKey.problem: TooManyStreamsOfKey,
    TooManyConnections.problem: TooManyConnections,
    WorkerDied.problem: WorkerDied,
    BuildStalled.problem: BuildStalled,
    BuildOutOfMemory.problem: BuildOutOfMemory,
    InternalError.problem: InternalError,
    MapNotFound.problem: MapNotFound,
    DriveNotFound.problem: DriveNotFound,
    ScanNotFound.problem: ScanNotFound,
    RevisionNotFound.problem: RevisionNotFound,
    BasisNotFound.problem: BasisNotFound,
    JobNotFound.problem: JobNotFound,
    NotInRecycleBin.problem: NotInRecycleBin,
    CaptureNotFound.problem: CaptureNotFound,
    KeyNotFound.problem: KeyNotFound,
    MapExists.problem: MapExists,
    DriveExists.problem: DriveExists,
    MapChanged.problem: MapChanged,
    ScanConflict.problem: ScanConflict,
    PosesDoNotFit.problem: PosesDoNotFit,
    DriveClosed.problem: DriveClosed,
    ReturnsGone.problem: ReturnsGone,
    NoLiveRevision.problem: NoLiveRevision,
    MapNotAnchored.problem: MapNotAnchored,
    RevisionIsLive.problem: RevisionIsLive,
    AmbiguousRevision.problem: AmbiguousRevision,
    BasisExists.problem: BasisExists,
    BasisInUse.problem: BasisInUse,
    JobNotRunning.problem: JobNotRunning,
    PartConflict.problem: PartConflict,
    PartsMissing.problem: PartsMissing,
    CaptureMismatch.problem: CaptureMismatch,
    CaptureQueued.problem: CaptureQueued,
    RequestKeyReused.problem: RequestKeyReused,
    CorruptImages.problem: CorruptImages,
    StorageBusy.problem: StorageBusy,
    StorageFull.problem: StorageFull,
    StorageReadOnly.problem: StorageReadOnly,
    StorageUnavailable.problem: StorageUnavailable,
}
