"""The actions that entries of the audit log name."""

from enum import StrEnum


class Action(StrEnum):
    """What an entry of the audit log says was done or refused.

    Of a request it is the name of its route's function. A name stays here, and is one of `RETIRED`,
    when its route is gone or is called otherwise: entries are for good.
    """

    BEGIN_CAPTURE = "begin_capture"
    BUILD = "build"
    CANCEL_JOB = "cancel_job"
    CLOSE_DRIVE = "close_drive"
    COLLECT_REVISION = "collect_revision"
    COMPLETE_CAPTURE = "complete_capture"
    COMPUTE_POSES = "compute_poses"
    CREATE_MAP = "create_map"
    DELETE_BASIS = "delete_basis"
    DELETE_CAPTURE = "delete_capture"
    DELETE_DRIVE = "delete_drive"
    DELETE_MAP = "delete_map"
    DELETE_REVISION = "delete_revision"
    DROP_RETURNS = "drop_returns"
    EXCHANGE_TOKEN = "exchange_token"  # noqa: S105 - no secret
    EXPIRE_CAPTURE = "expire_capture"
    FIT_MAP_ANCHOR = "fit_map_anchor"
    IMPORT_A_REVISION = "import_a_revision"
    MAKE_KEY = "make_key"
    MAKE_LIVE = "make_live"
    POST_SCANS = "post_scans"
    PUBLISH_REVISION = "publish_revision"
    PURGE_DELETED = "purge_deleted"
    PUT_DRIVE = "put_drive"
    PUT_PART = "put_part"
    PUT_POSES = "put_poses"
    PUT_SCAN = "put_scan"
    READ_CAPTURE = "read_capture"
    REPAIR_FILES = "repair_files"
    RESTORE_DELETED = "restore_deleted"
    REVOKE_KEY = "revoke_key"
    SHARE_BASIS = "share_basis"
    UPDATE_MAP = "update_map"


RETIRED = frozenset[Action]()
"""Actions that only earlier entries name."""
