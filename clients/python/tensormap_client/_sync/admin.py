# Made by make_sync.py: change _async instead.
"""An administrator: maps, drives, jobs, revisions, keys and the audit log of a service."""

from tensormap_client._sync.access_admin import AccessAdmin
from tensormap_client._sync.drive_admin import DriveAdmin
from tensormap_client._sync.job_admin import JobAdmin
from tensormap_client._sync.map_admin import MapAdmin
from tensormap_client._sync.revision_admin import RevisionAdmin


class Admin(MapAdmin, DriveAdmin, JobAdmin, RevisionAdmin, AccessAdmin):
    """Administers a service; each method needs its scope, and `admin` is all of them.

    Every method raises `Rejected` if the service rejects it (a subclass says why), `Unreachable` if
    it does not answer, and `InvalidArgument` if a name would lead to another resource, or is given
    in place of several, or a number is not finite. A request that would be another act the
    second time, as for a new key, is not repeated when its connection is lost, or when it is
    answered by 408, 502, 503 or 504 and may have been done: look whether it was.
    """
