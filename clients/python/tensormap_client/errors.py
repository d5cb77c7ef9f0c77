"""The error tree of the client.

ClientError
├── InvalidArgument     an argument that no request can be made of
├── ClientClosed        a client that is used after it was closed, or by a forked process
├── UnusableScan        a scan of which nothing is in the map's image
│   └── TooFewCells     a scan of which too little is, as with a covered sensor
├── UnsupportedMap      a map whose signatures this version cannot make
├── OtherDrive          a drive of the service that is not the one to upload
├── NothingUsable       a drive of which the service can use no scan
├── BuildFailed         a build that ended without a revision
├── CaptureFailed       a capture that the service could not read
├── Unreachable         a service that does not answer
│   └── UnreachableByProxy  one for which a proxy answers: a `Rejected` too
└── Rejected            a request that the service rejected
    └── ...             a class for each type of problem: `tensormap_client.problems`

`KeyWithoutTLS` is a warning.
"""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Self

from tensormap_client.uploaded import SkippedScan


class KeyWithoutTLS(UserWarning):
    """A key that is sent over plain HTTP, where everybody on the way can read it."""


class ClientError(Exception):
    """Base of the errors of this package."""


class InvalidArgument(ClientError, ValueError):
    """An argument that no request can be made of."""


class ClientClosed(ClientError):
    """A client that is used after it was closed, or in a process forked after it was made."""


class UnusableScan(ClientError):
    """A scan of which nothing is in the map's image."""


class TooFewCells(UnusableScan):
    """A scan of which too little is in the map's image, as with a covered sensor.

    The service refuses such a scan as `too_few_returns`, but cannot know it of a signature.
    """


class UnsupportedMap(ClientError):
    """A map whose signatures this version cannot make."""


class OtherDrive(ClientError):
    """A drive of the service that is not the one to upload."""


class NothingUsable(ClientError):
    """A drive of which the service can use no scan.

    Attributes:
        skipped: The first thousand of its scans, with the reasons.
    """

    def __init__(self, message: str, skipped: Sequence[SkippedScan] = ()) -> None:
        super().__init__(message)
        self.skipped = tuple(skipped)


class BuildFailed(ClientError):
    """A build that ended without a revision."""


class CaptureFailed(ClientError):
    """A capture that the service could not read."""


class Unreachable(ClientError):
    """A service that does not answer."""


class Rejected(ClientError):
    """A request that the service rejected.

    Attributes:
        problem: The last part of the problem's `type`, for example `map-not-found`; empty if the
            answer is not a problem document.
        status: The answer's HTTP status.
        detail: What was wanted and what was received.
        retry_after_s: How long to wait, in seconds, 0 if the service did not say.
        set_aside: The files that were not stored, each with `file`, `type` and `detail`; for
            `nothing-stored`.
    """

    problem: str = ""
    usual_status: ClassVar[int] = 0

    def __init__(
        self, message: str, status: int, problem: str, detail: str, retry_after_s: float = 0.0
    ) -> None:
        super().__init__(message)
        self.status, self.problem, self.detail = status, problem, detail
        self.retry_after_s = retry_after_s
        self.set_aside: Sequence[Mapping[str, str]] = ()

    def __reduce__(self) -> tuple[type[Self], tuple[Any, ...], dict[str, Any]]:
        """Return how a copy is made, as one that a pool of processes sends to its caller."""
        made_of = str(self), self.status, self.problem, self.detail, self.retry_after_s
        return type(self), made_of, self.__dict__

    @property
    def is_passing(self) -> bool:
        """Whether the same request may succeed later."""
        return self.status in {408, 429, 502, 503, 504}


class UnreachableByProxy(Rejected, Unreachable):
    """A request that a proxy answered with 502, 503 or 504: the service was away, or too slow."""
