"""The client of a TensorMap service: what a vehicle, a mapper or an administrator installs.

Each class exists twice: `Vehicle`, and `AsyncVehicle` with the same methods to await.
"""

from tensormap_client._async.admin import AsyncAdmin
from tensormap_client._async.locator import AsyncLocator
from tensormap_client._async.mapper import AsyncMapper
from tensormap_client._async.track import AsyncTrack
from tensormap_client._async.vehicle import AsyncVehicle
from tensormap_client._sync.admin import Admin
from tensormap_client._sync.locator import Locator
from tensormap_client._sync.mapper import Mapper
from tensormap_client._sync.track import Track
from tensormap_client._sync.vehicle import Vehicle
from tensormap_client.answers import (
    Localization,
    LocalizationInMaps,
    Match,
    MatchInMap,
    Pose,
    TrackAnswer,
)
from tensormap_client.captures import CaptureFiles
from tensormap_client.errors import (
    BuildFailed,
    CaptureFailed,
    ClientClosed,
    ClientError,
    InvalidArgument,
    KeyWithoutTLS,
    NothingUsable,
    OtherDrive,
    Rejected,
    TooFewCells,
    Unreachable,
    UnreachableByProxy,
    UnsupportedMap,
    UnusableScan,
)
from tensormap_client.prior import Prior
from tensormap_client.progress import Progress
from tensormap_client.signature.basis import Basis, Mounting, Tilt
from tensormap_client.sources import FolderSource, ScanBody, Source
from tensormap_client.uploaded import Uploaded

__all__ = [
    "Admin",
    "AsyncAdmin",
    "AsyncLocator",
    "AsyncMapper",
    "AsyncTrack",
    "AsyncVehicle",
    "Basis",
    "BuildFailed",
    "CaptureFailed",
    "CaptureFiles",
    "ClientClosed",
    "ClientError",
    "FolderSource",
    "InvalidArgument",
    "KeyWithoutTLS",
    "Localization",
    "LocalizationInMaps",
    "Locator",
    "Mapper",
    "Match",
    "MatchInMap",
    "Mounting",
    "NothingUsable",
    "OtherDrive",
    "Pose",
    "Prior",
    "Progress",
    "Rejected",
    "ScanBody",
    "Source",
    "Tilt",
    "TooFewCells",
    "Track",
    "TrackAnswer",
    "Unreachable",
    "UnreachableByProxy",
    "UnsupportedMap",
    "UnusableScan",
    "Uploaded",
    "Vehicle",
]
