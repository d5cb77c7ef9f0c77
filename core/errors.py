"""The error tree of the method.

TensorMapError
├── InvalidScan             a scan that cannot be used
│   └── TooFewReturns       not enough finite, non-zero returns are left
├── InvalidPose             a pose that is not a rigid motion
├── InvalidImage            an image of the wrong shape or content
├── InvalidParameters       a build or query parameter out of its range
├── InvalidMap              arrays that do not form a TensorMap
├── InvalidSignature        a signature of the wrong shape or content
├── StaleSignature          a signature made with another revision's bases
├── BasisMismatch           maps whose bases differ, where one is needed
├── FramesDisagree          drives of one map whose poses are in different world frames
├── PosesContradictScans    poses of a drive that its scans contradict
├── AnchorDoesNotFit        a GNSS track that does not fit the drive, or gives no heading
├── UnknownDrive            a drive the map does not have
├── StaleObservation        an observation that is not newer than the track's last one
├── UnknownSegment          a segment the map does not have
├── SensorMismatch          a query of a sensor or grid the map was not built for
├── EmptyDrive              a drive without a single scan to map
└── Cancelled               a long computation that its caller cancelled
"""


class TensorMapError(Exception):
    """Base of every error that this product raises on purpose."""


class InvalidScan(TensorMapError):
    """A scan that cannot be used."""


class TooFewReturns(InvalidScan):
    """Fewer finite, non-zero returns than required."""


class InvalidPose(TensorMapError):
    """Poses or times that cannot be read, or a pose that is not a rigid motion."""


class InvalidImage(TensorMapError):
    """An image whose shape, kind or values do not fit its grid."""


class InvalidParameters(TensorMapError):
    """A parameter out of its range."""


class InvalidMap(TensorMapError):
    """Arrays that do not form a TensorMap."""


class InvalidSignature(TensorMapError):
    """A signature with an invalid shape or invalid values."""


class StaleSignature(TensorMapError):
    """A signature made with bases that no available revision has."""


class BasisMismatch(TensorMapError):
    """Maps whose bases differ cannot be merged without their images."""


class FramesDisagree(TensorMapError):
    """Drives of one map whose poses are in different world frames."""


class PosesContradictScans(TensorMapError):
    """The scans of a drive show another motion than its poses."""


class AnchorDoesNotFit(TensorMapError):
    """The track of a GNSS receiver does not fit a drive, or does not give its heading."""


class UnknownDrive(TensorMapError):
    """A drive that the map does not have."""


class StaleObservation(TensorMapError):
    """An observation that is not newer than the last one of its track."""


class UnknownSegment(TensorMapError):
    """A segment that the map does not have."""


class SensorMismatch(TensorMapError):
    """A query of a sensor or grid that the map cannot answer."""


class EmptyDrive(TensorMapError):
    """A drive without a single scan."""


class Cancelled(TensorMapError):
    """A long computation that its caller cancelled."""
