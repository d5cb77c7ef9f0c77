"""The storage branch of the error tree.

StorageError                 a TensorMapError
├── NotFound                 the requested object is not stored
│   ├── MapNotFound
│   ├── DriveNotFound
│   ├── ScanNotFound
│   ├── RevisionNotFound
│   ├── BasisNotFound
│   ├── JobNotFound
│   ├── NotInRecycleBin
│   ├── CaptureNotFound
│   └── KeyNotFound
├── Conflict                 what is stored does not allow it
│   ├── MapExists            another map has this slug
│   ├── DriveExists          another drive of the map has this slug
│   ├── MapChanged           the map is no longer at the version the caller saw
│   ├── ScanConflict         other content is stored at this index
│   ├── PosesDoNotFit        poses that cannot be those of the scans that are stored
│   ├── DriveClosed          a closed drive takes no new scans
│   ├── ReturnsGone          the returns of a scan were dropped after a build
│   ├── NoLiveRevision       the map has no revision to answer with yet
│   ├── MapNotAnchored       where the map is on the Earth is not set
│   ├── RevisionIsLive       the live revision cannot be deleted
│   ├── AmbiguousRevision    several digests begin with this prefix
│   ├── BasisExists          another shared basis has this name, or this one another
│   ├── BasisInUse           revisions have this shared basis, or a build uses it
│   ├── JobNotRunning        only a running job makes progress or ends
│   ├── PartConflict         other bytes are stored as this part of a capture
│   ├── PartsMissing         a capture of which parts are missing cannot be read
│   ├── CaptureMismatch      files of a capture with another digest than was announced
│   ├── CaptureQueued        a capture that is read, or was, takes no more parts
│   └── RequestKeyReused     another request was made under this idempotency key
├── PartDoesNotFit           a part of another size or number than the capture has
├── TooManyBuilds            a key has reached its limit of queued jobs
├── TooManyCaptures          a key has reached its limit of bytes of captures
├── TooManyTokens            a key has reached its limit of valid tokens
├── InvalidSlug              a name that is no slug
├── CorruptFile              a file that is not what was written
│   └── CorruptImages        cached images that are not; a build makes them anew
├── StorageFailure           the disk or the database does not do its work
│   ├── StorageBusy          another writer kept the catalog locked for too long
│   │   └── LostRace         another writer changed the data between reading and writing
│   ├── StorageFull          no space or quota is left
│   ├── StorageReadOnly      the data cannot be written here
│   └── StorageUnavailable   the catalog's database fails or cannot be reached
├── WrongCatalog             the catalog is not that of this data directory or version
└── DataDirInUse             another server already owns this data directory
"""

from core.errors import TensorMapError


class StorageError(TensorMapError):
    """Base of every error that storage raises on purpose."""


class NotFound(StorageError):
    """The requested object is not stored."""


class MapNotFound(NotFound):
    """A map that is not there."""


class DriveNotFound(NotFound):
    """A drive that the map does not have."""


class ScanNotFound(NotFound):
    """A scan that the drive does not have."""


class RevisionNotFound(NotFound):
    """A revision that the map does not have, or no longer."""


class BasisNotFound(NotFound):
    """A shared basis that is not there."""


class JobNotFound(NotFound):
    """A job that is not there."""


class NotInRecycleBin(NotFound):
    """A deleted map or drive that is not in the recycle bin, or no longer."""


class CaptureNotFound(NotFound):
    """An uploaded capture that is not there, or no longer."""


class KeyNotFound(NotFound):
    """A key that is not there."""


class Conflict(StorageError):
    """What is stored does not allow the request."""


class MapExists(Conflict):
    """Another map has this slug."""


class DriveExists(Conflict):
    """Another drive of the map has this slug."""


class MapChanged(Conflict):
    """The map is no longer at the version that the caller saw."""


class ScanConflict(Conflict):
    """Other content is stored at this index."""


class PosesDoNotFit(Conflict):
    """Poses that cannot be those of the stored scans: too few, too many, or of another drive."""


class DriveClosed(Conflict):
    """A closed drive takes no new scans."""


class ReturnsGone(Conflict):
    """The returns of a scan were dropped after a build, by the map's retention policy."""


class NoLiveRevision(Conflict):
    """The map has no revision to answer with yet."""


class MapNotAnchored(Conflict):
    """Where the map is on the Earth is not set."""


class RevisionIsLive(Conflict):
    """The live revision cannot be deleted."""


class AmbiguousRevision(Conflict):
    """Several digests begin with this prefix."""


class BasisExists(Conflict):
    """Another shared basis has this name, or this one has another name."""


class BasisInUse(Conflict):
    """A shared basis that revisions have, or that a queued or running build uses."""


class JobNotRunning(Conflict):
    """Only a running job makes progress or ends."""


class PartConflict(Conflict):
    """Other bytes are stored as this part of a capture."""


class PartsMissing(Conflict):
    """A capture of which parts are missing or were lost; it cannot be read without them."""


class CaptureMismatch(Conflict):
    """A capture whose files have another digest than was announced."""


class CaptureQueued(Conflict):
    """A capture that waits to be read, is read, or was read takes no more parts."""


class RequestKeyReused(Conflict):
    """Another request was made under this idempotency key."""


class PartDoesNotFit(StorageError):
    """A part of another size, or of another number, than the capture has."""


class TooManyBuilds(StorageError):
    """A new job (a build or a capture) of a key that has reached its limit of queued jobs."""


class TooManyCaptures(StorageError):
    """A new capture of a key that has reached its limit of bytes of captures."""


class TooManyTokens(StorageError):
    """A new token of a key that has reached its limit of valid tokens."""


class InvalidSlug(StorageError):
    """A name that is no slug."""


class CorruptFile(StorageError):
    """A file whose content is not what was written."""


class CorruptImages(CorruptFile):
    """Cached images that are not what was written; a build makes them anew, once."""


class StorageFailure(StorageError):
    """The disk or the database does not do its work.

    Anybody may read its text; the cause, which may name paths, hosts and users, is what it was
    raised from: see `with_cause`.
    """


class StorageBusy(StorageFailure):
    """Another writer held the catalog for longer than the caller waits."""


class LostRace(StorageBusy):
    """Another writer changed the data between reading and writing: read again."""


class StorageFull(StorageFailure):
    """No space or quota is left."""


class StorageReadOnly(StorageFailure):
    """The data cannot be written here."""


class StorageUnavailable(StorageFailure):
    """The disk, or the catalog's database, fails or cannot be reached."""


class WrongCatalog(StorageError):
    """The catalog is not that of this data directory, or of another version of TensorMap."""


class DataDirInUse(StorageError):
    """Another server already owns this data directory."""


def with_cause(error: BaseException) -> str:
    """Return the text of an error for the operator: of a `StorageFailure` with its first cause.

    The cause is in one line: drivers of databases write several.

    Examples:
        >>> error = StorageFull("no space is left")
        >>> error.__cause__ = OSError("/data: No space left on device")
        >>> with_cause(error)
        'no space is left (/data: No space left on device)'
    """
    text, first = str(error), error
    while first.__cause__ is not None:
        first = first.__cause__
    cause = " ".join(str(first).split())
    if not isinstance(error, StorageFailure) or cause in text:
        return text
    return f"{text} ({cause})"
