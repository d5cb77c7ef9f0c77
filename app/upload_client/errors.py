"""The error tree of the client.

UploadFailed
├── Unreachable         a service that does not answer
├── Rejected            a request that the service rejected
├── OtherDrive          a drive of the service that is not the one to upload
├── NothingUsable       a drive of which the service can use no scan
└── BuildFailed         a build that ended without a revision
"""


class UploadFailed(Exception):
    """Base of the errors of an upload."""


class Unreachable(UploadFailed):
    """A service that does not answer."""


class Rejected(UploadFailed):
    """A request that the service rejected.

    Attributes:
        status: Of the answer.
        problem: The last word of its `type`, as `map-not-found`; empty if it is no problem.
        detail: What was expected and what was sent.
    """

    def __init__(self, message: str, status: int, problem: str, detail: str) -> None:
        super().__init__(message)
        self.status, self.problem, self.detail = status, problem, detail


class OtherDrive(UploadFailed):
    """A drive of the service that is not the one to upload."""


class NothingUsable(UploadFailed):
    """A drive of which the service can use no scan."""


class BuildFailed(UploadFailed):
    """A build that ended without a revision."""
