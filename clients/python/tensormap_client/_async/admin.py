"""An administrator: maps, drives, jobs, revisions, keys and the audit log of a service."""

from tensormap_client._async.access_admin import AsyncAccessAdmin
from tensormap_client._async.drive_admin import AsyncDriveAdmin
from tensormap_client._async.job_admin import AsyncJobAdmin
from tensormap_client._async.map_admin import AsyncMapAdmin
from tensormap_client._async.revision_admin import AsyncRevisionAdmin


class AsyncAdmin(
    AsyncMapAdmin, AsyncDriveAdmin, AsyncJobAdmin, AsyncRevisionAdmin, AsyncAccessAdmin
):
    """Administers a service; each method needs its scope, and `admin` is all of them.

    Every method raises `Rejected` if the service rejects it (a subclass says why), `Unreachable` if
    it does not answer, and `InvalidArgument` if a name would lead to another resource, or is given
    in place of several, or a number is not finite. A request that would be another act the
    second time, as for a new key, is not repeated when its connection is lost, or when it is
    answered by 408, 502, 503 or 504 and may have been done: look whether it was.
    """
